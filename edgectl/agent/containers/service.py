# SPDX-License-Identifier: Apache-2.0
"""Command line that creates the service of a task in a Docker Swarm: one container, on this node and no
other, which the swarm never starts again. As that of a container, it names variables and not their values.
"""

import os
import zlib

from ..link.fast_json import Document
from . import create

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping

# Node and task directory: what has it was made for this task on this node.
PLACE_LABEL = create.LABEL + "place"
# What a service may be named: a part of a domain name.
_MAX_NAME_LENGTH = 63
_DIGEST_LENGTH = 9
# The swarm fills in the name of the container, which has the id of its task in it.
_CONTAINER_NAME = "{{.Task.Name}}"
_SHARED_MEMORY = "/dev/shm"  # noqa: S108 - that of the host, which ROS 2 needs
# The engine keeps the output until it is in the log of the task.
_LOG_OPTIONS = ("--log-driver", "json-file", "--log-opt", "max-size=1m", "--log-opt", "max-file=2")


def build_service_name(fleet: str, host: str, task: str) -> str:
    """Build the name of the service of a task: a swarm has only one of it."""
    plain = create.build_container_name(fleet, host, task)
    name = plain.replace(".", "-").rstrip("-_")
    if name == plain and len(name) <= _MAX_NAME_LENGTH:
        return name
    return "%s-%08x" % (
        name[: _MAX_NAME_LENGTH - _DIGEST_LENGTH].rstrip("-_"),
        zlib.crc32(plain.encode("utf-8")),
    )


def build_place(node: str, folder: str) -> str:
    """Build the value of PLACE_LABEL; ``node``: the id of this node in its swarm."""
    return "%s:%s" % (node, folder)


def build_service_variables(variables: "Mapping[str, str]") -> "dict[str, str]":
    """Build the environment of the container from that of one which is no service: the swarm reads the values
    as templates.
    """
    found = {name: text.replace("{{", '{{"{{"}}') for name, text in variables.items()}
    found[create.NAME_VARIABLE] = _CONTAINER_NAME
    return found


def build_service_words(
    name: str,
    node: str,
    image_id: str,
    spec: Document,
    identity: Document,
    folder: str,
    variables: "Mapping[str, str]",
) -> "list[str]":
    """Build the words after ``docker`` that create the service; ``variables``: as `build_service_variables`.

    By ``image_id`` a node takes the image that it has, and asks no registry: it was pulled before.
    """
    image = spec["image"]
    words = ["service", "create", "--detach", "--quiet", "--no-resolve-image", "--name", name]
    words += ["--mode", "replicated", "--replicas", "1", "--constraint", "node.id==%s" % node]
    words += ["--restart-condition", "none", "--init", "--no-healthcheck", "--network", image["network"]]
    words += _LOG_OPTIONS
    labels = dict(create.build_labels(identity, folder), **{PLACE_LABEL: build_place(node, folder)})
    for label, text in sorted(labels.items()):
        words += ["--label", "%s=%s" % (label, text), "--container-label", "%s=%s" % (label, text)]
    words += create.build_variable_options(variables)
    for mount in _list_mounts(image, folder, variables):
        words += ["--mount", mount]
    words += _build_limit_options(image, spec.get("limits") or {})
    words += list(image["args"])
    words += [image_id]
    return words + create.build_shell_words(spec)


def _list_mounts(image: Document, folder: str, variables: "Mapping[str, str]") -> "list[str]":
    mounts = [_build_mount(volume) for volume in image["volumes"]]
    if image["ipc"] == "host":
        mounts.append(_build_mount("%s:%s" % (_SHARED_MEMORY, _SHARED_MEMORY)))
    metrics = create.find_metrics_volume(folder, variables)
    return mounts + ([_build_mount(metrics)] if metrics else [])


def _build_mount(volume: str) -> str:
    """Translate ``HOST:CONTAINER`` or ``HOST:CONTAINER:ro`` to the form of services, fields of CSV."""
    source, target, *options = os.path.expanduser(volume).split(":")
    kind = "bind" if source.startswith("/") else "volume"
    fields = ["type=" + kind, "source=" + source, "target=" + target]
    fields += ["readonly"] if "ro" in options else []
    escaped = (field.replace("{{", '{{"{{"}}') for field in fields)
    return ",".join('"%s"' % each.replace('"', '""') if set(each) & {",", '"'} else each for each in escaped)


def _build_limit_options(image: Document, limits: Document) -> "list[str]":
    words: "list[str]" = []
    if image.get("user"):
        words += ["--user", image["user"]]
    if image.get("workdir"):
        words += ["--workdir", image["workdir"]]
    if limits.get("cpu"):
        words += ["--limit-cpu", create.format_cpus(float(limits["cpu"]))]
    if limits.get("memory"):
        words += ["--limit-memory", "%db" % int(limits["memory"])]
    return words
