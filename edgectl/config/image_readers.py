# SPDX-License-Identifier: Apache-2.0
"""Readers of the container image of a task; the table of its keys."""

import re
from collections.abc import Mapping
from typing import Any

from edgectl.config.fields import list_reader, read_environment, record_reader
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import INVALID, NodeReader, enum_reader, integer_reader, read_text
from edgectl.config.schema import build_object_schema, describe_as, describe_reader, get_reader_schema
from edgectl.model.image import ContainerEngine, ContainerImage, PullPolicy

# Compiled when an image is read, which few files have.
_REFERENCE_PATTERN = r"[A-Za-z0-9][A-Za-z0-9._/:@-]{0,254}"
# A placeholder may be part of these; a leading - would be an option of the engine.
_DEVICE_PATTERN = r"/[^\s,:]+(?::[^\s,:]+){0,2}|[a-z0-9][\w.-]*/[\w.-]+=[\w.:-]+"
_VOLUME_PATTERN = r"(?:[/~{]|[A-Za-z0-9])[^:]*:[/{][^:]*(?::[A-Za-z,]+)?"
_WORD_PATTERN = r"[A-Za-z0-9{][A-Za-z0-9._:/{}-]*"
_OPTION_PATTERN = r"(?s)--?([A-Za-z][a-z-]*)(?:=.*)?"
# Options by which edgectl finds, follows and ends its containers.
_OWN_OPTIONS = (
    *("name", "cidfile", "rm", "restart", "init", "log-driver", "pull", "detach-keys", "stop-signal"),
    *("d", "detach", "i", "interactive", "t", "tty", "cgroupns", "cgroup-parent", "pid"),
)
# Those of a service, besides.
_OWN_SERVICE_OPTIONS = (
    *("mode", "replicas", "replicas-max-per-node", "constraint", "placement-pref", "q", "quiet"),
    *("restart-condition", "restart-delay", "restart-max-attempts", "restart-window"),
    *("log-opt", "no-healthcheck", "no-resolve-image"),
)
# Options of a container that a service does not know.
_CONTAINER_OPTIONS = (
    *("privileged", "device", "device-cgroup-rule", "gpus", "ipc", "shm-size", "security-opt"),
    *("v", "volume", "volumes-from", "m", "memory", "cpus", "p", "add-host", "runtime"),
)
_NEEDS_DOCKER = "write engine: docker"


def _text_reader(pattern: str, what: str, hint: str) -> NodeReader:
    """A text of a form; ``what`` it is not, otherwise."""

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        value = read_text(node, problems)
        if isinstance(value, str) and not re.fullmatch(pattern, value):
            problems.add(node.mark, ProblemCode.TEXT, f"{value!r} is no {what}", hint)
            return INVALID
        return value

    return describe_reader(read, lambda: {"type": "string", "pattern": f"^(?:{pattern})$"})


read_reference = _text_reader(
    _REFERENCE_PATTERN,
    "name of an image",
    "write a name such as ros:jazzy, or registry.lab:5000/slam@sha256:..",
)


@describe_as(lambda: {"anyOf": [{"const": "all"}, {"type": "integer", "minimum": 1, "maximum": 64}]})
def _read_gpus(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The word ``all``, or how many."""
    if node.value == "all":
        return "all"
    number = integer_reader(1, 64)(node, problems)
    return number if number is INVALID else str(number)


@describe_as(lambda: {"type": "string", "pattern": "^-"})
def _read_option(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """One option of the engine with its value, as one word."""
    value = read_text(node, problems)
    if not isinstance(value, str):
        return value
    found = re.fullmatch(_OPTION_PATTERN, value)
    if found is None:
        hint = "write options with their values as one word: --shm-size=1g"
        problems.add(node.mark, ProblemCode.TEXT, f"{value!r} is no option of the engine", hint)
        return INVALID
    if found[1] in _OWN_OPTIONS:
        message = f"{value.partition('=')[0]} is an option that edgectl sets itself"
        problems.add(node.mark, ProblemCode.CONTRADICTION, message, "remove it")
        return INVALID
    return value


@describe_as(
    lambda: {"anyOf": [get_reader_schema(read_reference), build_object_schema(IMAGE_KEYS, ("name",))]}
)
def read_image(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The image of a task: its name, or a mapping."""
    if isinstance(node.value, dict):
        image = record_reader(IMAGE_KEYS, ContainerImage, "image", ("name",))(node, problems)
        if isinstance(image, ContainerImage) and image.engine is ContainerEngine.SWARM:
            _check_service(node.value, image, problems)
        return image
    name = read_reference(node, problems)
    return name if name is INVALID else ContainerImage(name=name)


def _check_service(nodes: Mapping[str, Node], image: ContainerImage, problems: Problems) -> None:
    """What a service of a swarm cannot have of its host."""

    def report(node: Node, message: str, hint: str) -> None:
        problems.add(node.mark, ProblemCode.CONTRADICTION, message, hint)

    if image.devices:
        report(nodes["devices"], "a service of a swarm has no devices", f"remove devices, or {_NEEDS_DOCKER}")
    if image.gpus is not None:
        hint = f'{_NEEDS_DOCKER}, or remove gpus and write args: ["--generic-resource=gpu=1"]'
        report(nodes["gpus"], "a service of a swarm has no gpus", hint)
    if image.ipc not in ("host", "private"):
        message = "a service of a swarm has shared memory of its own, or that of the host"
        report(nodes["ipc"], message, "write ipc: host, or private")
    for inner in _list_inner(nodes.get("volumes")):
        if str(inner.value).split(":")[2:] not in ([], ["ro"], ["rw"]):
            message = "a volume of a service of a swarm has no options but ro"
            report(inner, message, f"write /srv/maps:/maps:ro, or {_NEEDS_DOCKER}")
    for inner in _list_inner(nodes.get("args")):
        _check_service_option(inner, problems)


def _list_inner(node: Node | None) -> list[Node]:
    return node.value if node is not None and isinstance(node.value, list) else []


def _check_service_option(node: Node, problems: Problems) -> None:
    """An option of ``docker create`` that ``docker service create`` does not have, or has for edgectl."""
    found = re.fullmatch(_OPTION_PATTERN, str(node.value))
    option = str(node.value).partition("=")[0]
    if found is not None and found[1] in _OWN_SERVICE_OPTIONS:
        message = f"{option} is an option that edgectl sets itself"
        problems.add(node.mark, ProblemCode.CONTRADICTION, message, "remove it")
    elif found is not None and found[1] in _CONTAINER_OPTIONS:
        message = f"a service of a swarm has no option {option}"
        problems.add(node.mark, ProblemCode.CONTRADICTION, message, f"remove it, or {_NEEDS_DOCKER}")


IMAGE_KEYS: Mapping[str, NodeReader] = {
    "name": read_reference,
    "engine": enum_reader(ContainerEngine),
    "gpus": _read_gpus,
    "devices": list_reader(
        _text_reader(_DEVICE_PATTERN, "device", "write /dev/video0, or /dev/video0:/dev/camera")
    ),
    "volumes": list_reader(
        _text_reader(_VOLUME_PATTERN, "volume", "write /srv/maps:/maps, /srv/maps:/maps:ro, or NAME:/maps")
    ),
    "env": read_environment,
    "user": _text_reader(_WORD_PATTERN, "user", 'write a name, or "1000:1000"'),
    "network": _text_reader(_WORD_PATTERN, "network", "write host, bridge, none, or the name of a network"),
    "ipc": _text_reader(_WORD_PATTERN, "IPC namespace", "write host, private, shareable or none"),
    "pull": enum_reader(PullPolicy),
    "args": list_reader(_read_option),
}
