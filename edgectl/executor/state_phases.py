# SPDX-License-Identifier: Apache-2.0
"""The phases that hand over the state of a task. Pure."""

from dataclasses import replace

from edgectl.executor import state_requests
from edgectl.executor.action_phases import (
    PlannedPhase,
    PlannedPhases,
    PlannedRequest,
    build_run_phases,
    get_host,
)
from edgectl.executor.host_requests import NO_INSTANCE
from edgectl.model.inventory import Inventory
from edgectl.model.result import Phase
from edgectl.model.task import Task


def build_carry_phases(
    task: Task, old: str, new: str, inventory: Inventory, *, instance: str | None = None
) -> PlannedPhases:
    """Save the state of ``instance`` (None: the living one) on ``old``, and bring it to ``new``.

    Nothing for a task without state.
    """
    if task.state is None:
        return ()
    source, target, hosts = get_host(inventory, old), get_host(inventory, new), inventory.hosts
    seconds = state_requests.get_save(task.state).timeout
    save = state_requests.build_save_request(task, task.state, source, hosts, instance)
    pieces = (
        PlannedRequest(host=target, body=state_requests.build_write_request(task.name, target)),
        PlannedRequest(host=source, body=state_requests.build_read_request(task.name, source)),
    )
    request = PlannedRequest(host=source, body=save, timeout_s=seconds)
    return (
        PlannedPhase(phase=Phase.SAVE, task=task.name, requests=(request,)),
        PlannedPhase(phase=Phase.TRANSFER, task=task.name, requests=pieces),
    )


def build_load_phases(
    task: Task, host_name: str, inventory: Inventory, *, repeat: bool, instance: str = NO_INSTANCE
) -> PlannedPhases:
    """Give the state to ``instance``, or to the one that was started last; nothing for a task without state.

    ``repeat``: it was just started and may not take it yet, so ``load`` is repeated until its timeout.
    """
    if task.state is None:
        return ()
    host, seconds = get_host(inventory, host_name), state_requests.get_load(task.state).timeout
    body = state_requests.build_load_request(task, task.state, host, inventory.hosts, repeat=repeat)
    request = PlannedRequest(host=host, body={**body, "instance": instance}, timeout_s=seconds)
    return (PlannedPhase(phase=Phase.LOAD, task=task.name, requests=(request,)),)


def build_carried_run_phases(
    task: Task,
    host_name: str,
    inventory: Inventory,
    *,
    phase: Phase = Phase.START,
    replaces: tuple[str, ...] | None = None,
) -> PlannedPhases:
    """As `build_run_phases`; the state that is kept on the host is loaded in between."""
    start, ready = build_run_phases(task, host_name, inventory, phase=phase, replaces=replaces)
    return keep_state(start), *build_load_phases(task, host_name, inventory, repeat=True), ready


def keep_state(planned: PlannedPhase) -> PlannedPhase:
    """The stop or start of a move, which leaves the state that its host keeps."""
    request, *others = planned.requests
    kept = replace(request, body={**request.body, "keep_state": True})
    return replace(planned, requests=(kept, *others))
