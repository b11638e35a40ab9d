"""What ``apply`` would send, in order, without sending it."""

import sys
from collections.abc import Iterator

from edgectl.executor import requests
from edgectl.executor.order import STARTING, hold_without_old, replaces, stops
from edgectl.model.inventory import Connection, Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import Phase
from edgectl.model.task import Check, HandoffOrder, Task, Tasks, Where
from edgectl.transport.call import command_line

_Sent = tuple[Phase, str, requests.Request]


def dry_run(plan: Plan, inventory: Inventory, tasks: Tasks) -> list[dict[str, object]]:
    """One entry per request that changes or asks something: task, phase, host, the remote command line and its standard input.

    Instance ids and generations are made when a plan is applied; here they stand as 0.
    """
    sent = [(step, _stop(step, host, inventory, tasks.tasks.get(step.task))) for step in plan.steps for host in stops(step)]
    for step in plan.steps:
        task = tasks.tasks.get(step.task)
        if step.action in STARTING and task is not None:
            sent += [(step, request) for request in _change(step, task, inventory)]
    return [_entry(step, request, inventory) for step, request in sent]


def _entry(step: Step, sent: _Sent, inventory: Inventory) -> dict[str, object]:
    phase, host, request = sent
    python = sys.executable if inventory.hosts[host].connection is Connection.LOCAL else "python3"
    return {"task": step.task, "phase": phase.value, "host": host, "command": command_line(python), "stdin": request}


def _change(step: Step, task: Task, inventory: Inventory) -> Iterator[_Sent]:
    """The phases of a start, a move or a restart."""
    new, old = step.decision.host, step.decision.previous_host
    if new is None:
        return
    start = list(_start(task, new, inventory))
    if step.action is not Action.START:
        old = old or new
        yield from _hook(Phase.SAFE, task, task.handoff.safe_when, old, inventory)
        yield from _hook(Phase.HOLD, task, task.handoff.hold, old, inventory)
        stop = _stop(step, old, inventory, task)
        start_first = old != new and task.handoff.order is HandoffOrder.START_FIRST
        yield from (*start, stop) if start_first else (stop, *start)
        yield from _hook(Phase.RELEASE, task, task.handoff.release, new, inventory)
    elif replaces(step):
        yield from _hook(Phase.HOLD, task, hold_without_old(task), new, inventory)
        yield from start
        yield from _hook(Phase.RELEASE, task, task.handoff.release, new, inventory)
    else:
        yield from start


def _start(task: Task, name: str, inventory: Inventory) -> Iterator[_Sent]:
    host = inventory.hosts[name]
    yield Phase.START, name, requests.start(task, host, inventory.hosts, instance="0", generation=0)
    timeout = task.ready.timeout if task.ready else 0.0
    yield Phase.READY, name, requests.wait(task.name, host, instance="0", timeout_s=timeout)
    if task.ready is not None and task.ready.on is Where.ROBOT:
        yield from _hook(Phase.READY, task, task.ready, name, inventory)


def _stop(step: Step, name: str, inventory: Inventory, task: Task | None) -> _Sent:
    request = requests.stop(step.task, inventory.hosts[name], task=task, instance=step.instances.get(name))
    return Phase.STOP, name, request


def _hook(phase: Phase, task: Task, rule: Check | None, host: str, inventory: Inventory) -> Iterator[_Sent]:
    if rule is not None:
        where = task.robots[0] if rule.on is Where.ROBOT and task.robots else host
        yield phase, where, requests.check(task, rule, inventory.hosts[where], inventory.hosts)
