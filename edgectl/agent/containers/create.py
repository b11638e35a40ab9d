# SPDX-License-Identifier: Apache-2.0
"""Command line that creates the container of a task. It names the variables of the task and not their values:
command lines are public.
"""

import os

from ..link.fast_json import Document
from ..measure import metrics
from ..supervise import liveness

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping

LABEL = "edgectl."
# The task directory: what has it was made by this user for this task, whatever its name.
DIR_LABEL = LABEL + "dir"
NAME_VARIABLE = "EDGECTL_CONTAINER"
_METRICS_IN_CONTAINER = "/run/edgectl/metrics"
# The process that --init puts first passes signals on to the whole group of the command.
_GROUP_VARIABLE = "TINI_KILL_PROCESS_GROUP"
# A shell dies of a signal at once, and the container with it; with a trap it waits for what it runs.
_TRAPS = "trap 'exit 143' TERM; trap 'exit 130' INT; trap 'exit 129' HUP; trap : QUIT USR1 USR2\n"
_MIN_CPUS = 0.01
# Their values stand on the command line, since the engine's own must stay as they are.
_OWN_VARIABLES = ("PATH", "HOME", "TMPDIR", "XDG_RUNTIME_DIR", "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY")
_OWN_PREFIXES = ("DOCKER_", "CONTAINER", "BUILDAH_", "LD_")


def build_container_name(fleet: str, host: str, task: str) -> str:
    """Build the name of the container of a task: an engine has only one of it."""
    return "edgectl-%s-%s-%s" % (fleet, host, task)


def build_labels(identity: Document, folder: str) -> "dict[str, str]":
    """Build the labels that tell the container of a task from all others."""
    found = {LABEL + name: str(identity[name]) for name in ("fleet", "host", "task", "instance")}
    found[DIR_LABEL] = folder
    return found


def build_variables(spec: Document, identity: Document, folder: str) -> "dict[str, str]":
    """Build the environment of the container."""
    found = {str(name): str(value) for name, value in (spec.get("env") or {}).items()}
    cookie, _, value = liveness.build_cookie(folder).partition("=")
    found.update({cookie: value, "EDGECTL_INSTANCE": identity["instance"], _GROUP_VARIABLE: "1"})
    found[NAME_VARIABLE] = build_container_name(identity["fleet"], identity["host"], identity["task"])
    if os.path.exists(metrics.get_metrics_path(folder)):
        found["EDGECTL_METRICS"] = _METRICS_IN_CONTAINER
    return found


def build_engine_environment(login: "Mapping[str, str]", variables: "Mapping[str, str]") -> "dict[str, str]":
    """Build the environment of the engine's program: that of the login, and what it passes on by name."""
    return dict(login, **{name: text for name, text in variables.items() if not _is_own_variable(name)})


def _is_own_variable(name: str) -> bool:
    """Whether the engine's program reads the variable itself, or its loader."""
    return name in _OWN_VARIABLES or name.startswith(_OWN_PREFIXES)


def build_create_argv(
    program: str, spec: Document, identity: Document, folder: str, variables: "Mapping[str, str]"
) -> "list[str]":
    """Build the argument vector of ``docker create``; ``variables``: the environment of the container.

    The image must be there already: pulling takes minutes, and is done before the old instance stops.
    """
    image = spec["image"]
    argv = [program, "create", "--name", variables[NAME_VARIABLE], "--init", "--pull", "never"]
    argv += ["--log-driver", "none", "--network", image["network"], "--ipc", image["ipc"]]
    for label, text in sorted(build_labels(identity, folder).items()):
        argv += ["--label", "%s=%s" % (label, text)]
    argv += build_variable_options(variables)
    volume = find_metrics_volume(folder, variables)
    argv += ["--volume", volume] if volume else []
    argv += _build_resource_options(program, image, spec.get("limits") or {})
    argv += list(image["args"])
    argv += [image["name"]]
    return argv + build_shell_words(spec)


def build_variable_options(variables: "Mapping[str, str]") -> "list[str]":
    """Build the options that pass the environment of the container on by name."""
    words: "list[str]" = []
    for name, text in sorted(variables.items()):
        words += ["--env", "%s=%s" % (name, text) if _is_own_variable(name) else name]
    return words


def find_metrics_volume(folder: str, variables: "Mapping[str, str]") -> str:
    """Find the volume of the application's metrics; empty where it has none."""
    if "EDGECTL_METRICS" not in variables:
        return ""
    return "%s:%s" % (metrics.get_metrics_path(folder), _METRICS_IN_CONTAINER)


def build_shell_words(spec: Document) -> "list[str]":
    """Build what runs the command of the task in the container; nothing where the image's own runs."""
    return ["/bin/sh", "-c", _TRAPS + spec["command"]] if spec["command"] else []


def format_cpus(cores: float) -> str:
    """Format a limit in cores: the engine refuses more than the host has."""
    return "%.2f" % max(_MIN_CPUS, min(cores, float(os.cpu_count() or 1)))


def _build_resource_options(program: str, image: Document, limits: Document) -> "list[str]":
    """Build the options for what the container may use of its host."""
    argv: "list[str]" = []
    if image.get("gpus"):
        argv += _build_gpu_options(program, str(image["gpus"]))
    for device in image["devices"]:
        argv += ["--device", device]
    for volume in image["volumes"]:
        argv += ["--volume", os.path.expanduser(volume)]
    if image.get("user"):
        argv += ["--user", image["user"]]
    if image.get("workdir"):
        argv += ["--workdir", image["workdir"]]
    if limits.get("cpu"):
        argv += ["--cpus", format_cpus(float(limits["cpu"]))]
    if limits.get("memory"):
        argv += ["--memory", "%db" % int(limits["memory"])]
    return argv


def _build_gpu_options(program: str, gpus: str) -> "list[str]":
    if os.path.basename(program) != "podman":
        return ["--gpus", gpus]
    # podman knows NVIDIA's cards by the names of the Container Device Interface.
    if gpus == "all":
        return ["--device", "nvidia.com/gpu=all"]
    return [word for number in range(int(gpus)) for word in ("--device", "nvidia.com/gpu=%d" % number)]
