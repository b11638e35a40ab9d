"""What ``apply`` would send, in order, without sending it."""

import sys
from collections.abc import Iterator

from edgectl.executor import host_requests
from edgectl.executor.dependencies import (
    STARTING_ACTIONS,
    find_replacement_hold,
    is_replacement,
    list_stop_hosts,
)
from edgectl.model.inventory import Connection, Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import Phase
from edgectl.model.task import Check, CheckLocation, HandoffOrder, Task, Tasks
from edgectl.transport.agent_client import build_agent_command

_PlannedRequest = tuple[Phase, str, host_requests.Request]


def list_dry_run_requests(plan: Plan, inventory: Inventory, tasks: Tasks) -> list[dict[str, object]]:
    """One entry per request that changes or asks something: task, phase, host, the remote command line and its standard input.

    Instance ids and generations are made when a plan is applied; here they stand as 0.
    """
    sent = [
        (step, _plan_stop_request(step, host, inventory, tasks.tasks.get(step.task)))
        for step in plan.steps
        for host in list_stop_hosts(step)
    ]
    for step in plan.steps:
        task = tasks.tasks.get(step.task)
        if step.action in STARTING_ACTIONS and task is not None:
            sent += [(step, request) for request in _list_change_requests(step, task, inventory)]
    return [_encode_dry_run_entry(step, request, inventory) for step, request in sent]


def _encode_dry_run_entry(step: Step, sent: _PlannedRequest, inventory: Inventory) -> dict[str, object]:
    phase, host, request = sent
    python = sys.executable if inventory.hosts[host].connection is Connection.LOCAL else "python3"
    return {
        "task": step.task,
        "phase": phase.value,
        "host": host,
        "command": build_agent_command(python),
        "stdin": request,
    }


def _list_change_requests(step: Step, task: Task, inventory: Inventory) -> Iterator[_PlannedRequest]:
    """The phases of a start, a move or a restart."""
    new, old = step.decision.host, step.decision.previous_host
    if new is None:
        return
    start = list(_list_start_requests(task, new, inventory))
    if step.action is not Action.START:
        old = old or new
        yield from _list_hook_requests(Phase.SAFE, task, task.handoff.safe_when, old, inventory)
        yield from _list_hook_requests(Phase.HOLD, task, task.handoff.hold, old, inventory)
        stop = _plan_stop_request(step, old, inventory, task)
        start_first = old != new and task.handoff.order is HandoffOrder.START_FIRST
        yield from (*start, stop) if start_first else (stop, *start)
        yield from _list_hook_requests(Phase.RELEASE, task, task.handoff.release, new, inventory)
    elif is_replacement(step):
        yield from _list_hook_requests(Phase.HOLD, task, find_replacement_hold(task), new, inventory)
        yield from start
        yield from _list_hook_requests(Phase.RELEASE, task, task.handoff.release, new, inventory)
    else:
        yield from start


def _list_start_requests(task: Task, name: str, inventory: Inventory) -> Iterator[_PlannedRequest]:
    host = inventory.hosts[name]
    yield (
        Phase.START,
        name,
        host_requests.build_start_request(task, host, inventory.hosts, instance="0", generation=0),
    )
    timeout = task.ready.timeout if task.ready else 0.0
    yield (
        Phase.READY,
        name,
        host_requests.build_wait_request(task.name, host, instance="0", timeout_s=timeout),
    )
    if task.ready is not None and task.ready.on is CheckLocation.ROBOT:
        yield from _list_hook_requests(Phase.READY, task, task.ready, name, inventory)


def _plan_stop_request(step: Step, name: str, inventory: Inventory, task: Task | None) -> _PlannedRequest:
    request = host_requests.build_stop_request(
        step.task, inventory.hosts[name], task=task, instance=step.instances.get(name)
    )
    return Phase.STOP, name, request


def _list_hook_requests(
    phase: Phase, task: Task, rule: Check | None, host: str, inventory: Inventory
) -> Iterator[_PlannedRequest]:
    if rule is not None:
        where = task.robots[0] if rule.on is CheckLocation.ROBOT and task.robots else host
        yield (
            phase,
            where,
            host_requests.build_check_request(task, rule, inventory.hosts[where], inventory.hosts),
        )
