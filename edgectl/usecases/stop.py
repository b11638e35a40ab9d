# SPDX-License-Identifier: Apache-2.0
"""Stop and restart of tasks by name, through the same executor as apply."""

import dataclasses
from collections.abc import Sequence

from edgectl.errors import UnansweredError, UsageError, describe_unseen_task
from edgectl.executor.operator_plans import (
    build_restart_plan,
    build_stop_plan,
    drop_given_up_runs,
    list_copies,
    list_running_instances,
    list_unseen_placements,
)
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.names import check_known_names
from edgectl.rules.lost_places import describe_lost_place, list_lost_tasks
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan
from edgectl.usecases.plan_execution import (
    ApplyOptions,
    ApplyResult,
    Confirm,
    confirm_always,
    confirm_and_execute,
    lock_fleet,
)
from edgectl.usecases.probe import probe_fleet


def stop_tasks(
    fleet: Fleet,
    names: Sequence[str] | None,
    confirm: Confirm = confirm_always,
    options: ApplyOptions | None = None,
) -> ApplyResult:
    """Stop the named tasks (None: all) on every host. The next apply starts them again unless they are marked
    done.

    A task last known on a host that does not answer, or at a lost place, is an action with the outcome
    ``unreachable``.

    Raises:
        UsageError: a name is neither in the files nor running.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with lock_fleet(fleet, "stop", options) as held:
        snapshot = probe_fleet(held, options.probe)
        wanted = (
            list(_list_known_tasks(snapshot)) if names is None else _check_task_names(fleet, names, snapshot)
        )
        return confirm_and_execute(
            held,
            build_stop_plan(wanted, fleet.inventory, fleet.tasks, snapshot),
            confirm,
            options,
            verb="stop",
        )


def start_tasks(
    fleet: Fleet,
    policy: Policy,
    names: Sequence[str],
    confirm: Confirm = confirm_always,
    options: ApplyOptions | None = None,
) -> ApplyResult:
    """Start the named tasks where a plan of now places them, also those that failed, completed or are marked
    done. What runs already is left alone.

    Raises:
        UsageError: a task is not in the files.
        UnansweredError: one may run on a host that does not answer or left the inventory.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    check_known_names(names, fleet.tasks.tasks, "task")
    with lock_fleet(fleet, "start", options) as held:
        snapshot = probe_fleet(held, options.probe)
        running = list_running_instances(snapshot)
        absent = [name for name in dict.fromkeys(names) if name not in running]
        manager = snapshot.manager or ManagerState()
        done = {name: spec for name, spec in manager.done.items() if name not in absent}
        forgiven = dataclasses.replace(snapshot, manager=dataclasses.replace(manager, done=done))
        for name in absent:
            _check_not_unseen(name, snapshot, "started")
            forgiven = drop_given_up_runs(name, forgiven, completed=True)
        made = make_plan(held, policy, snapshot=forgiven)
        steps = tuple(step for step in made.steps if step.task in names)
        plan = dataclasses.replace(made, steps=steps, expected={}, tasks_left_alone={})
        return confirm_and_execute(held, plan, confirm, options, verb="start")


def restart_tasks(
    fleet: Fleet, names: Sequence[str], confirm: Confirm = confirm_always, options: ApplyOptions | None = None
) -> ApplyResult:
    """Stop running tasks and start each again on its host; those that failed for good are started where they
    are placed now. If one cannot be, none is.

    Raises:
        UsageError: one is not in the files, neither runs nor failed for good, or has no placement.
        UnansweredError: one may run on a host that does not answer or left the inventory.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with lock_fleet(fleet, "restart", options) as held:
        snapshot = probe_fleet(held, options.probe)
        wanted = _check_task_names(fleet, names, snapshot)
        return confirm_and_execute(
            held, _plan_restarts(held, wanted, snapshot), confirm, options, verb="restart"
        )


def _plan_restarts(fleet: Fleet, names: Sequence[str], snapshot: Snapshot) -> Plan:
    running, forgiven = list_running_instances(snapshot), snapshot
    given_up = [name for name in names if name not in running]
    for name in names:
        if name not in fleet.tasks.tasks:
            raise UsageError(f"{name} is not in the task files", hint="edgectl apply")
    for name in given_up:
        _check_not_unseen(name, snapshot, "restarted")
        before, forgiven = forgiven, drop_given_up_runs(name, forgiven)
        if forgiven == before:
            raise UsageError(f"{name} is not running", hint="edgectl apply")
    restarts = build_restart_plan(
        [name for name in names if name in running], fleet.inventory, fleet.tasks, forgiven
    )
    if not given_up:
        return restarts
    made = make_plan(fleet, fleet.tasks.policy, snapshot=forgiven)
    starts = tuple(step for step in made.steps if step.task in given_up and step.action is Action.START)
    placed = {step.task for step in starts}
    without = next((name for name in given_up if name not in placed), None)
    if without is not None:
        raise UsageError(
            f"{without} has no placement now",
            hint=f"edgectl reopen {without}; edgectl plan then shows the reason",
        )
    return dataclasses.replace(made, steps=restarts.steps + starts, expected={})


def _check_not_unseen(name: str, snapshot: Snapshot, act: str) -> None:
    """Refuse to call a task stopped that may run on a host that does not answer, or at a lost place.

    Raises:
        UnansweredError: it was last known there; or it is seen nowhere and is not given up anywhere.
    """
    host = list_unseen_placements(snapshot).get(name)
    if host is not None:
        raise UnansweredError(
            f"not {act}: {describe_unseen_task(name, host)}",
            hint=f"try again once {host} answers; if {host} is powered off: edgectl fence {host}",
        )
    lost = list_lost_tasks(snapshot).get(name)
    if lost is not None:
        raise UnansweredError(f"not {act}: {name} {describe_lost_place(lost)}", hint="edgectl plan")
    silent = snapshot.silent_hosts
    if silent and drop_given_up_runs(name, snapshot) == snapshot:
        raise UnansweredError(
            f"{name} runs on no host that answers; no answer from {', '.join(silent)}",
            hint="edgectl doctor",
        )


def _check_task_names(fleet: Fleet, names: Sequence[str], snapshot: Snapshot) -> list[str]:
    check_known_names(names, [*fleet.tasks.tasks, *_list_known_tasks(snapshot)], "task")
    return list(dict.fromkeys(names))


def _list_known_tasks(snapshot: Snapshot) -> dict[str, object]:
    """The tasks that run or wait, or may run on a silent host or at a lost place."""
    return {
        **list_copies(snapshot),
        **list_running_instances(snapshot),
        **list_unseen_placements(snapshot),
        **list_lost_tasks(snapshot),
    }
