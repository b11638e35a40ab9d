# SPDX-License-Identifier: Apache-2.0
"""Nomad: a job in JSON for each task, on the node of the plan (ADR 157)."""

import math
from collections.abc import Sequence

from edgectl.export.engine_task import EngineFiles, EngineTask, note_common_gaps
from edgectl.export.kubernetes import count_gpus
from edgectl.model.image import ContainerImage, PullPolicy
from edgectl.model.secret import Secret
from edgectl.model.task import RestartPolicy

Part = dict[str, object]
_NANOSECONDS = 10**9
# Nomad counts processors in MHz: so many stand for one core of the plan.
MHZ_PER_CORE = 1000
_LEAST_MHZ, _LEAST_MIB = 1, 10
_NODE_VARIABLE = "${node.unique.name}"


def build_nomad_jobs(tasks: Sequence[EngineTask], fleet: str) -> EngineFiles:
    """One job file for each task, for ``nomad job run -json``. Tasks without an image use raw_exec."""
    files = EngineFiles()
    for each in tasks:
        _note_nomad_gaps(files, each)
        files.files[f"{each.label}.nomad.json"] = {"Job": _build_job(each, fleet)}
    return files


def _build_job(each: EngineTask, fleet: str) -> Part:
    return {
        "ID": each.label,
        "Name": each.label,
        "Type": "batch" if each.completes else "service",
        "Datacenters": ["*"],
        "Meta": {"fleet": fleet, "task": each.task.name},
        "Constraints": [{"LTarget": _NODE_VARIABLE, "Operand": "=", "RTarget": each.host.name}],
        "TaskGroups": [
            {
                "Name": each.label,
                "Count": 1,
                "RestartPolicy": _build_restart_policy(each),
                # Another node is the plan's to choose.
                "ReschedulePolicy": {"Attempts": 0, "Unlimited": False},
                "Tasks": [_build_task(each)],
            }
        ],
    }


def _build_restart_policy(each: EngineTask) -> Part:
    often = each.task.restart is not RestartPolicy.NEVER
    return {
        "Attempts": 3 if often else 0,
        "Interval": 300 * _NANOSECONDS,
        "Delay": 5 * _NANOSECONDS,
        "Mode": "delay" if often and not each.completes else "fail",
    }


def _build_task(each: EngineTask) -> Part:
    task, image = each.task, each.image
    plain = {name: value for name, value in each.env.items() if not isinstance(value, Secret)}
    part: Part = {
        "Name": each.label,
        "Driver": "raw_exec" if image is None else "docker",
        "Config": _build_host_command(each) if image is None else _build_docker_config(each, image),
        "Env": plain,
        "Resources": _build_resources(each),
        "KillSignal": f"SIG{task.stop.signal.removeprefix('SIG')}",
        "KillTimeout": math.ceil(task.stop.grace * _NANOSECONDS),
        "LogConfig": {
            "MaxFiles": task.log.files,
            "MaxFileSizeMB": max(1, math.ceil(task.log.max_size / 2**20)),
        },
    }
    secrets = [name for name, value in each.env.items() if isinstance(value, Secret)]
    if secrets:
        part["Templates"] = [_build_secret_template(each, secrets)]
    return part


def _build_host_command(each: EngineTask) -> Part:
    lines = [each.host.prelude] if each.host.prelude else []
    lines += [f"cd {_quote(each.task.workdir)}"] if each.task.workdir else []
    return {"command": "/bin/bash", "args": ["-c", "\n".join([*lines, each.task.command])]}


def _quote(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"


def _build_docker_config(each: EngineTask, image: ContainerImage) -> Part:
    task = each.task
    config: Part = {"image": image.name, "network_mode": image.network, "ipc_mode": image.ipc, "init": True}
    if task.command:
        config |= {"command": "/bin/sh", "args": ["-c", task.command]}
    if task.workdir:
        config["work_dir"] = task.workdir
    if image.pull is PullPolicy.ALWAYS:
        config["force_pull"] = True
    if image.volumes:
        config["volumes"] = list(image.volumes)
    if image.devices:
        config["devices"] = [_build_device(device) for device in image.devices]
    return config


def _build_device(device: str) -> Part:
    path, _, inside = device.partition(":")
    inside, _, rights = inside.partition(":")
    found: Part = {"host_path": path, "container_path": inside or path}
    return found | ({"cgroup_permissions": rights} if rights else {})


def _build_resources(each: EngineTask) -> Part:
    caps, demand = each.task.limits, each.demand
    resources: Part = {
        "CPU": max(_LEAST_MHZ, math.ceil(demand.get("cpu", 0.0) * MHZ_PER_CORE)),
        "MemoryMB": max(_LEAST_MIB, math.ceil(demand.get("memory", 0.0) / 2**20)),
    }
    if caps.memory:
        resources["MemoryMaxMB"] = max(_LEAST_MIB, math.ceil(caps.memory / 2**20))
    gpus = count_gpus(each, each.image or ContainerImage(name=""))
    if gpus:
        resources["Devices"] = [{"Name": "nvidia/gpu", "Count": gpus}]
    return resources


def _build_secret_template(each: EngineTask, names: Sequence[str]) -> Part:
    path = f"nomad/jobs/{each.label}"
    lines = [f'{name}={{{{ with nomadVar "{path}" }}}}{{{{ .{name} }}}}{{{{ end }}}}' for name in names]
    return {"DestPath": "secrets/task.env", "Envvars": True, "EmbeddedTmpl": "\n".join(lines) + "\n"}


def _note_nomad_gaps(files: EngineFiles, each: EngineTask) -> None:
    task = each.task
    if each.needs:
        files.add_note(each, "needs are left out: jobs of Nomad do not wait for each other")
    if task.ready is not None or task.alive is not None:
        files.add_note(each, "ready and alive are left out: checks that run a command need Consul")
    if task.limits.cpu:
        files.add_note(each, "the limit of cores is left out: Nomad has shares")
    if each.image is not None and each.image.user:
        files.add_note(each, "the user of the image is left out")
    note_common_gaps(files, each, secrets="the Nomad variable nomad/jobs/TASK")
