# SPDX-License-Identifier: Apache-2.0
"""BlueChi: a systemd unit for each task and the commands that start it on its node (ADR 157)."""

import math
from collections.abc import Sequence

from edgectl.export.engine_task import EngineFiles, EngineNeed, EngineTask, note_common_gaps, select_probe
from edgectl.export.kubernetes import count_gpus
from edgectl.model.image import ContainerImage
from edgectl.model.secret import Secret
from edgectl.model.task import NeedCondition, RestartPolicy

PLACEMENTS_FILE = "placements.sh"
_RESTART = {RestartPolicy.ALWAYS: "always", RestartPolicy.ON_FAILURE: "on-failure", RestartPolicy.NEVER: "no"}
_ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "%": "%%", "$": "$$"}


def build_bluechi_units(tasks: Sequence[EngineTask], fleet: str) -> EngineFiles:
    """``NODE/UNIT`` for each task, a Quadlet where it has an image, and the commands that start them all."""
    files = EngineFiles()
    commands = [
        "#!/bin/sh",
        f"# Starts the tasks of {fleet} where the plan puts them; the units are there already.",
    ]
    for each in tasks:
        _note_bluechi_gaps(files, each)
        suffix = "service" if each.image is None else "container"
        files.files[f"{each.host.name}/{_name_unit(each.label)}.{suffix}"] = _build_unit(each)
        commands.append(f"bluechictl start {each.host.name} {_name_unit(each.label)}.service")
    files.files[PLACEMENTS_FILE] = "\n".join(commands) + "\n"
    return files


def _name_unit(label: str) -> str:
    return f"edgectl-{label}"


def _build_unit(each: EngineTask) -> str:
    service = [*_list_service_settings(each), *_list_limits(each)]
    if each.image is None:
        sections = {"Unit": _list_unit_settings(each), "Service": [*_list_command(each), *service]}
    else:
        sections = {
            "Unit": _list_unit_settings(each),
            "Container": _list_container_settings(each, each.image),
            "Service": service,
        }
    parts = [f"[{name}]\n" + "\n".join(lines) for name, lines in sections.items()]
    return "\n\n".join(parts) + "\n"


def _list_unit_settings(each: EngineTask) -> list[str]:
    lines = [f"Description={_escape_text(each.task.name)} of edgectl"]
    for need in each.needs:
        unit = _name_needed_unit(each, need)
        lines += [f"Wants={unit}", f"After={unit}"]
    return lines


def _name_needed_unit(each: EngineTask, need: EngineNeed) -> str:
    """A unit of the same node, or BlueChi's stand-in for one of another."""
    unit = f"{_name_unit(need.label)}.service"
    return unit if need.host == each.host.name else f"bluechi-proxy@{need.host}_{unit}"


def _list_command(each: EngineTask) -> list[str]:
    text = "\n".join([each.host.prelude, each.task.command] if each.host.prelude else [each.task.command])
    return [
        "Type=exec",
        f"ExecStart=/bin/bash -c {quote_argument(text)}",
        *([f"WorkingDirectory={_escape_text(each.task.workdir)}"] if each.task.workdir else []),
        *_list_environment(each),
    ]


def _list_environment(each: EngineTask) -> list[str]:
    plain = {name: value for name, value in each.env.items() if not isinstance(value, Secret)}
    lines = [f"Environment={_quote_assignment(f'{name}={value}')}" for name, value in plain.items()]
    return lines + ([f"EnvironmentFile=/etc/edgectl/{each.label}.env"] if len(plain) < len(each.env) else [])


def _list_container_settings(each: EngineTask, image: ContainerImage) -> list[str]:
    lines = [
        f"Image={_escape_text(image.name)}",
        f"ContainerName={_name_unit(each.label)}",
        f"Network={image.network}",
        *([f"Exec=/bin/sh -c {quote_argument(each.task.command)}"] if each.task.command else []),
        *([f"WorkingDir={_escape_text(each.task.workdir)}"] if each.task.workdir else []),
        *([f"User={image.user}"] if image.user else []),
        "RunInit=true",
        f"PodmanArgs=--ipc={image.ipc}",
        f"Pull={image.pull.value}",
        *(f"Volume={_escape_text(volume)}" for volume in image.volumes),
        *(f"AddDevice={_escape_text(device)}" for device in image.devices),
        *(["AddDevice=nvidia.com/gpu=all"] if count_gpus(each, image) else []),
        *_list_environment(each),
    ]
    alive = select_probe(each.task.alive.check if each.task.alive is not None else None)
    return lines + ([] if alive is None else [f"HealthCmd={_escape_text(alive)}"])


def _list_service_settings(each: EngineTask) -> list[str]:
    stop = each.task.stop
    return [
        f"Restart={_RESTART[each.task.restart]}",
        *([] if each.image is not None else [f"KillSignal=SIG{stop.signal.removeprefix('SIG')}"]),
        f"TimeoutStopSec={math.ceil(stop.grace)}",
    ]


def _list_limits(each: EngineTask) -> list[str]:
    caps = each.task.limits
    lines = [f"CPUQuota={math.ceil(caps.cpu * 100)}%"] if caps.cpu else []
    return lines + ([f"MemoryMax={math.ceil(caps.memory)}"] if caps.memory else [])


def quote_argument(text: str) -> str:
    """One argument of a command line of systemd, nothing of which it fills in."""
    return '"' + "".join(_ESCAPES.get(char, char) for char in text) + '"'


def _quote_assignment(text: str) -> str:
    """A variable: as an argument, but systemd fills in no variables there."""
    return quote_argument(text).replace("$$", "$")


def _escape_text(text: str) -> str:
    return text.replace("%", "%%")


def _note_bluechi_gaps(files: EngineFiles, each: EngineTask) -> None:
    if any(need.until is NeedCondition.COMPLETED for need in each.needs):
        files.add_note(each, "needs until completed became an order of starts")
    if each.task.ready is not None or (each.task.alive is not None and each.image is None):
        files.add_note(each, "ready and alive are left out: systemd asks nothing of a service")
    note_common_gaps(files, each, secrets="/etc/edgectl/TASK.env on the node")
