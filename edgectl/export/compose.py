# SPDX-License-Identifier: Apache-2.0
"""Compose: a file for each host of the plan, with its tasks as services (ADR 157)."""

import math
from collections.abc import Sequence
from typing import Any

from edgectl.export.engine_task import (
    PROBE_PERIOD_S,
    EngineFiles,
    EngineTask,
    check_images,
    note_common_gaps,
    select_probe,
)
from edgectl.export.kubernetes import count_gpus
from edgectl.model.image import ContainerImage, PullPolicy
from edgectl.model.secret import Secret
from edgectl.model.task import NeedCondition, RestartPolicy

Service = dict[str, Any]
_RESTART = {RestartPolicy.ALWAYS: "always", RestartPolicy.ON_FAILURE: "on-failure", RestartPolicy.NEVER: "no"}
_PULL = {PullPolicy.MISSING: "if_not_present", PullPolicy.ALWAYS: "always", PullPolicy.NEVER: "never"}


def build_compose_files(tasks: Sequence[EngineTask], fleet: str) -> EngineFiles:
    """One file for each host.

    Raises:
        UsageError: a task has no image.
    """
    check_images(tasks, "Compose")
    files = EngineFiles()
    probed = {each.label for each in tasks if _find_health_command(each) is not None}
    for each in tasks:
        _note_compose_gaps(files, each)
        file: Any = files.files.setdefault(
            f"{each.host.name}.compose.yaml",
            {"x-edgectl": {"fleet": fleet, "host": each.host.name}, "services": {}},
        )
        file["services"][each.label] = _build_service(each, each.image or ContainerImage(name=""), probed)
    return files


def _build_service(each: EngineTask, image: ContainerImage, probed: set[str]) -> Service:
    task = each.task
    service: Service = {"image": image.name, "pull_policy": _PULL[image.pull], "init": True}
    if task.command:
        service["command"] = ["/bin/sh", "-c", task.command]
    if task.workdir:
        service["working_dir"] = task.workdir
    service |= {"network_mode": image.network, "ipc": image.ipc, "restart": _RESTART[task.restart]}
    for key, value in (("user", image.user), ("volumes", image.volumes), ("devices", image.devices)):
        if value:
            service[key] = value if isinstance(value, str) else list(value)
    service |= {
        "stop_signal": f"SIG{task.stop.signal.removeprefix('SIG')}",
        "stop_grace_period": f"{math.ceil(task.stop.grace)}s",
        "logging": {
            "driver": "json-file",
            "options": {"max-size": f"{math.ceil(task.log.max_size)}", "max-file": str(task.log.files)},
        },
        "deploy": {"resources": _build_resources(each, image)},
    }
    service |= _build_health_check(each)
    waits = {
        need.label: _build_condition(need.until, need.label in probed)
        for need in each.needs
        if need.host == each.host.name
    }
    if waits:
        service["depends_on"] = waits
    service = _escape_dollars(service)
    # A variable that must be set where the file is run.
    service["environment"] = {
        name: f"${{{name}:?}}" if isinstance(value, Secret) else value.replace("$", "$$")
        for name, value in each.env.items()
    }
    return service


def _escape_dollars(value: Any) -> Any:  # noqa: ANN401
    """``value`` with each dollar doubled: Compose fills in variables everywhere."""
    if isinstance(value, str):
        return value.replace("$", "$$")
    if isinstance(value, dict):
        return {key: _escape_dollars(inner) for key, inner in value.items()}
    return [_escape_dollars(inner) for inner in value] if isinstance(value, list) else value


def _build_resources(each: EngineTask, image: ContainerImage) -> Service:
    caps = each.task.limits
    reserved = _build_amounts(each.demand.get("cpu"), each.demand.get("memory"))
    gpus = count_gpus(each, image)
    if gpus:
        count = "all" if image.gpus == "all" else gpus
        reserved["devices"] = [{"driver": "nvidia", "count": count, "capabilities": ["gpu"]}]
    parts = {"reservations": reserved, "limits": _build_amounts(caps.cpu, caps.memory)}
    return {name: amounts for name, amounts in parts.items() if amounts}


def _build_amounts(cores: float | None, amount: float | None) -> Service:
    return ({"cpus": f"{cores:.3f}"} if cores else {}) | (
        {"memory": f"{math.ceil(amount)}b"} if amount else {}
    )


def _find_health_command(each: EngineTask) -> str | None:
    alive = each.task.alive.check if each.task.alive is not None else None
    return select_probe(each.task.ready) or select_probe(alive)


def _build_health_check(each: EngineTask) -> Service:
    """A service of Compose has one check: ``ready``, else ``alive``."""
    command = _find_health_command(each)
    if command is None:
        return {}
    period = f"{PROBE_PERIOD_S:g}s"
    return {
        "healthcheck": {"test": ["CMD-SHELL", command], "interval": period, "timeout": period, "retries": 3}
    }


def _build_condition(until: NeedCondition, probed: bool) -> Service:  # noqa: FBT001
    if until is NeedCondition.COMPLETED:
        return {"condition": "service_completed_successfully"}
    return {"condition": "service_healthy" if until is NeedCondition.READY and probed else "service_started"}


def _note_compose_gaps(files: EngineFiles, each: EngineTask) -> None:
    if any(need.host != each.host.name for need in each.needs):
        files.add_note(each, "needs on other hosts are left out: a compose file is of one host")
    if each.task.ready is not None and each.task.alive is not None:
        files.add_note(each, "alive is left out: a service has one check, and that is ready")
    note_common_gaps(files, each, secrets="the environment in which the file is run")
