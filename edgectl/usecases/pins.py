# SPDX-License-Identifier: Apache-2.0
"""Pins that operators set on tasks: ``move`` and ``unpin`` (ADR 140)."""

import dataclasses
from collections.abc import Sequence
from typing import NoReturn

from edgectl.dataclass import dataclass
from edgectl.errors import UnansweredError, UsageError
from edgectl.model.assignment import RejectionRule
from edgectl.model.manager_state import ManagerState, Pin
from edgectl.model.plan import Plan, Step
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import join_units
from edgectl.names import check_known_names
from edgectl.scheduler.capacities import build_capacities
from edgectl.scheduler.demand import add_measured_demands
from edgectl.scheduler.operator_pins import find_pin_obstacle
from edgectl.state.manager_state import load_manager_state, save_manager_state
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.operator_marks import change_marks
from edgectl.usecases.plan import make_plan
from edgectl.usecases.probe import probe_fleet

# Why a host can never run a task, and what would change that.
_OBSTACLES = {
    RejectionRule.PIN: (
        "is pinned to {pin} by its task file, not to {host}",
        "change hosts.pin of {entry} in its task file",
    ),
    RejectionRule.NOT_ONLY: (
        "may not run on {host}: hosts.only leaves it out",
        "add it to hosts.only of {entry} in its task file",
    ),
    RejectionRule.NEVER: (
        "may not run on {host}: it is in hosts.never",
        "remove it from hosts.never of {entry} in its task file",
    ),
    RejectionRule.LABELS: (
        "may not run on {host}, which lacks the labels {labels}",
        "label it in the inventory: labels: {{..}}",
    ),
    RejectionRule.ONBOARD: (
        "may not run on {host}: its onboard, or that of its robot, leaves {host} out",
        "change onboard of {entry} in its task file, or of the robot in the inventory",
    ),
    RejectionRule.NO_ENGINE: (
        "may not run on {host}, which has no container engine for its image",
        "edgectl doctor {host}",
    ),
    RejectionRule.INSUFFICIENT: (
        "can never run on {host}: it demands more than the whole host, or its link, has",
        "edgectl describe task {task}; edgectl get hosts",
    ),
    RejectionRule.APART: (
        "may not run on {host}: the file of a task that it is apart from pins that one there",
        "change apart or hosts.pin of {entry} in its task file",
    ),
    RejectionRule.DEADLINE_MISSED: (
        "can never keep its hard deadline on {host}, even if nothing else ran there",
        "edgectl explain {task} -o wide",
    ),
    RejectionRule.NO_LINK: ("can never run on {host}, which has no link to its robot", "edgectl doctor"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedTask:
    """A pin that was set, and what the next apply does with the task. ``plan``: of the whole fleet.

    ``again``: the task had the same pin before.
    """

    pin: Pin
    step: Step
    plan: Plan
    again: bool = False


def pin_task(
    fleet: Fleet,
    policy: Policy,
    name: str,
    host: str,
    *,
    duration: float | None = None,
    dry_run: bool = False,
) -> MovedTask:
    """Pin the task ``name`` to ``host``, for ``duration`` seconds (None: until it is unpinned), and plan. The
    next apply moves it. ``dry_run``: plan only.

    Of tasks that go together one is pinned, and the others follow it.

    Raises:
        UsageError: the task or the host is unknown, or the host can never run the task, or is cordoned.
        UnansweredError: the host does not answer.
        LockBusyError: another edgectl is changing this fleet.
    """
    check_known_names([name], fleet.tasks.tasks, "task")
    check_known_names([host], fleet.inventory.hosts, "host")
    snapshot = probe_fleet(fleet)
    unit = join_units(fleet.tasks.tasks).get(name, (name,))
    for mate in unit:
        _check_can_run(fleet, policy, mate, host, snapshot)
    pin = Pin(
        host=host,
        since=snapshot.taken_at,
        until=None if duration is None else snapshot.taken_at + duration,
        machine=snapshot.hosts[host].machine,
    )
    manager = snapshot.manager or ManagerState()
    pins = {task: each for task, each in manager.pins.items() if task not in unit} | {name: pin}
    pinned = dataclasses.replace(snapshot, manager=dataclasses.replace(manager, pins=pins))
    plan = make_plan(fleet, policy, snapshot=pinned)
    step = next(step for step in plan.steps if step.task == name)
    if step.decision.pin is not None and step.decision.pin.set_aside in _OBSTACLES:
        _refuse_pin(fleet, name, host, step.decision.pin.set_aside)  # what concerns other tasks too
    if not dry_run:
        with change_marks(fleet, "move"):
            stored = load_manager_state(fleet.state, fleet.warn)
            kept = {task: each for task, each in stored.pins.items() if task not in unit}
            save_manager_state(fleet.state, dataclasses.replace(stored, pins=kept | {name: pin}))
    before = manager.pins.get(name)
    again = before is not None and (before.host, before.until, pin.until) == (host, None, None)
    return MovedTask(pin=pin, step=step, plan=plan, again=again)


def unpin_tasks(fleet: Fleet, names: Sequence[str], *, dry_run: bool = False) -> dict[str, bool]:
    """Remove the pins of tasks; whether each one was pinned. The next plan places them by utility.

    Raises:
        UsageError: a task is neither in the files nor pinned.
        LockBusyError: another edgectl is changing this fleet.
    """
    if dry_run:
        return _find_pinned(fleet, names, load_manager_state(fleet.state, fleet.warn))
    with change_marks(fleet, "unpin"):
        manager = load_manager_state(fleet.state, fleet.warn)
        found = _find_pinned(fleet, names, manager)
        kept = {name: pin for name, pin in manager.pins.items() if name not in names}
        save_manager_state(fleet.state, dataclasses.replace(manager, pins=kept))
    return found


def _find_pinned(fleet: Fleet, names: Sequence[str], manager: ManagerState) -> dict[str, bool]:
    check_known_names(names, [*fleet.tasks.tasks, *manager.pins], "task")
    now = fleet.clock()
    return {name: name in manager.pins and manager.pins[name].is_active(now) for name in names}


def _check_can_run(fleet: Fleet, policy: Policy, name: str, host: str, snapshot: Snapshot) -> None:
    """Refuse a pin that no plan could follow."""
    task, sample = fleet.tasks.tasks[name], snapshot.hosts.get(host)
    manager = snapshot.manager or ManagerState()
    if not task.managed:
        raise UsageError(f"{name} is not managed by edgectl", hint="set managed: true in its task file")
    if policy.name is PolicyName.LOCAL:
        raise UsageError(
            "the policy local keeps every task on its robot, whatever it is pinned to",
            hint="state another policy in the task file",
        )
    if host in manager.cordons or host in manager.draining:
        raise UsageError(f"{host} is cordoned", hint=f"edgectl uncordon {host}")
    if sample is None or not sample.ok:
        raise UnansweredError(f"{name} was not moved: {host} does not answer", hint=f"edgectl doctor {host}")
    capacities = add_measured_demands(
        build_capacities(fleet.inventory, snapshot, manager, frozenset()), fleet.tasks, manager
    )
    rule = find_pin_obstacle(task, host, capacities, best_effort=policy.best_effort)
    if rule is not None:
        _refuse_pin(fleet, name, host, rule)


def _refuse_pin(fleet: Fleet, name: str, host: str, rule: RejectionRule) -> NoReturn:
    task = fleet.tasks.tasks[name]
    message, hint = _OBSTACLES[rule]
    words = {
        "task": name,
        "host": host,
        "entry": task.template,
        "pin": task.hosts.pin,
        "labels": ", ".join(f"{key}={value}" for key, value in task.hosts.labels.items()),
    }
    raise UsageError(f"{name} {message.format(**words)}", hint=hint.format(**words))
