"""Stop and restart of tasks by name, through the same executor as apply."""

import dataclasses
from collections.abc import Sequence

from edgectl.errors import UsageError
from edgectl.executor.operator_plans import (
    build_restart_plan,
    build_stop_plan,
    drop_given_up_runs,
    list_running_instances,
)
from edgectl.model.plan import Action, Plan
from edgectl.model.snapshot import Snapshot
from edgectl.names import check_known_names
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

    Raises:
        UsageError: a name is neither in the files nor running.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with lock_fleet(fleet, "stop", options) as held:
        snapshot = probe_fleet(held, options.probe)
        wanted = (
            list(list_running_instances(snapshot))
            if names is None
            else _check_task_names(fleet, names, snapshot)
        )
        return confirm_and_execute(
            held,
            build_stop_plan(wanted, fleet.inventory, fleet.tasks, snapshot),
            confirm,
            options,
            verb="stop",
        )


def restart_task(
    fleet: Fleet, name: str, confirm: Confirm = confirm_always, options: ApplyOptions | None = None
) -> ApplyResult:
    """Stop a running task and start it again on its host; one that failed for good is started where it is
    placed now.

    Raises:
        UsageError: it is not in the files, neither runs nor failed for good, or has no placement.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with lock_fleet(fleet, "restart", options) as held:
        snapshot = probe_fleet(held, options.probe)
        _check_task_names(fleet, [name], snapshot)
        return confirm_and_execute(
            held, _plan_restart(held, name, snapshot), confirm, options, verb="restart"
        )


def _plan_restart(fleet: Fleet, name: str, snapshot: Snapshot) -> Plan:
    if name not in fleet.tasks.tasks:
        raise UsageError(f"{name} is not in the task files", hint="edgectl apply")
    if name in list_running_instances(snapshot):
        return build_restart_plan(name, fleet.inventory, fleet.tasks, snapshot)
    forgiven = drop_given_up_runs(name, snapshot)
    if forgiven == snapshot:
        raise UsageError(f"{name} is not running", hint="edgectl apply")
    made = make_plan(fleet, fleet.tasks.policy, snapshot=forgiven)
    steps = tuple(step for step in made.steps if step.task == name and step.action is Action.START)
    if not steps:
        raise UsageError(
            f"{name} has no placement now", hint=f"edgectl reopen {name}; edgectl plan then shows the reason"
        )
    return dataclasses.replace(made, steps=steps, expected={})


def _check_task_names(fleet: Fleet, names: Sequence[str], snapshot: Snapshot) -> list[str]:
    check_known_names(names, [*fleet.tasks.tasks, *list_running_instances(snapshot)], "task")
    return list(dict.fromkeys(names))
