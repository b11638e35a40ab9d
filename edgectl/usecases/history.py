# SPDX-License-Identifier: Apache-2.0
"""Revisions of a fleet, and rollback to the placement of an earlier one."""

import dataclasses
from collections.abc import Mapping

from edgectl.errors import UsageError
from edgectl.executor.diff import plan_from_assignment
from edgectl.executor.operator_plans import build_rollback_plan
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.revision import Revision
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.assign import assign
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.journal_reader import read_journal_cached
from edgectl.state.revisions import load_revisions
from edgectl.usecases.coordination import refresh_state
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan_execution import (
    ApplyOptions,
    ApplyResult,
    Confirm,
    confirm_always,
    confirm_and_execute,
    lock_fleet,
)
from edgectl.usecases.probe import probe_fleet


def list_revisions(fleet: Fleet) -> tuple[Revision, ...]:
    """Every revision that this machine knows, oldest first."""
    return load_revisions(fleet.state, fleet.warn)


def list_shared_revisions(fleet: Fleet) -> tuple[Revision, ...]:
    """The same, once those that other machines have saved in etcd are known here."""
    if fleet.lease is None:
        refresh_state(fleet)
    return list_revisions(fleet)


def find_last_carries(fleet: Fleet) -> dict[str, ActionResult]:
    """By task, the last move that loaded its state on another host."""
    return {
        action.task: action
        for revision in list_revisions(fleet)
        for action in revision.actions
        if action.state is not None and action.state.host and action.outcome is Outcome.DONE
    }


def get_revision(fleet: Fleet, number: int) -> Revision:
    """The revision of this number.

    Raises:
        UsageError: there is no such revision.
    """
    known = list_shared_revisions(fleet)
    found = next((each for each in reversed(known) if each.number == number), None)
    if found is None:
        hint = (
            f"the last one is {known[-1].number}; list them: edgectl history"
            if known
            else "nothing was applied yet"
        )
        raise UsageError(f"no revision {number}", hint=hint)
    return found


def plan_rollback(fleet: Fleet, policy: Policy, number: int | None, options: ApplyOptions) -> Plan:
    """A new plan that restores the placement after revision ``number`` (None: before the last one).

    Raises:
        UsageError: there is no such revision, or its placement was not recorded.
    """
    target = _get_rollback_target(fleet, number)
    wanted = _get_placements(target)
    snapshot = probe_fleet(fleet, options.probe)
    if policy.terms:
        from edgectl.usecases.ratings import add_ratings

        snapshot = add_ratings(fleet, policy, snapshot)
    manager = snapshot.manager or ManagerState()
    pinned = dataclasses.replace(
        fleet.tasks,
        tasks={name: _pin_task(fleet, task, wanted, snapshot) for name, task in fleet.tasks.tasks.items()},
    )
    how = dataclasses.replace(policy, name=PolicyName.UTILITY)
    assignment = assign(fleet.inventory, pinned, snapshot, manager, how, snapshot.taken_at)
    _warn_of_missing(fleet, wanted, fleet.tasks)
    return build_rollback_plan(
        plan_from_assignment(fleet.inventory, pinned, snapshot, manager, assignment), wanted, target.number
    )


def roll_back_fleet(
    fleet: Fleet,
    policy: Policy,
    number: int | None = None,
    confirm: Confirm = confirm_always,
    options: ApplyOptions | None = None,
) -> ApplyResult:
    """Plan towards an earlier placement, ask, execute.

    Raises:
        UsageError: there is no such revision, or its placement was not recorded.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with lock_fleet(fleet, "rollback", options) as held:
        return confirm_and_execute(
            held, plan_rollback(held, policy, number, options), confirm, options, verb="rollback"
        )


def _get_rollback_target(fleet: Fleet, number: int | None) -> Revision:
    known = list_shared_revisions(fleet)
    if number is not None:
        return get_revision(fleet, number)
    # Another machine may have made the last one, and told no more than its number: it died in it.
    numbered = read_journal_cached(fleet.state / JOURNAL_FILE_NAME).revision
    last = max([numbered, *(each.number for each in known[-1:])])
    earlier = [each for each in known if each.number < last]
    if not earlier:
        raise UsageError("there is no revision before the last one", hint="list revisions: edgectl history")
    if fleet.inventory.coordination is not None and earlier[-1].number < last - 1:
        raise UsageError(
            f"revision {last - 1}, the one before the last, was made on another machine and is not known "
            "here: it was interrupted, or made by an older edgectl",
            hint="choose another one: edgectl history; edgectl rollback REV",
        )
    return earlier[-1]


def _get_placements(target: Revision) -> Mapping[str, str]:
    if target.placements is None:
        raise UsageError(
            f"the placement after revision {target.number} is not known here: it was interrupted, made by an "
            "older edgectl, or on another machine long ago",
            hint="choose another one: edgectl history; edgectl rollback REV",
        )
    return target.placements


def _pin_task(fleet: Fleet, task: Task, wanted: Mapping[str, str], snapshot: Snapshot) -> Task:
    """The task restricted to its earlier host; a pin in the file or of an operator wins, and a host that is
    gone is ignored.
    """
    host, mark = wanted.get(task.name), (snapshot.manager or ManagerState()).pins.get(task.name)
    pinned = task.hosts.pin is not None or (mark is not None and mark.is_active(snapshot.taken_at))
    if host is None or host not in fleet.inventory.hosts or pinned:
        return task
    return dataclasses.replace(task, hosts=dataclasses.replace(task.hosts, pin=host))


def _warn_of_missing(fleet: Fleet, wanted: Mapping[str, str], tasks: Tasks) -> None:
    for name, host in wanted.items():
        if name not in tasks.tasks:
            fleet.warn(f"{name} ran on {host} then but is no longer in the task files; it is not started")
        elif host not in fleet.inventory.hosts:
            fleet.warn(
                f"{name} ran on {host} then, which is no longer in the inventory; it is placed as by apply"
            )
