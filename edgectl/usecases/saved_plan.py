# SPDX-License-Identifier: Apache-2.0
"""Check of a saved plan of any author against the files and the tasks that run now. Pure."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Assignment, Decision, Reason, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.snapshot import Snapshot
from edgectl.model.standby_plan import StandbyAction
from edgectl.model.task import Tasks
from edgectl.names import natural_key
from edgectl.scheduler.assign import assign

if TYPE_CHECKING:
    from edgectl.scheduler.integer_program import Solver

# Decisions that no load changes: held, completed, given up or unmanaged now must be so in the plan, too.
_FIXED_VERDICTS = (Verdict.HELD, Verdict.COMPLETED)
_FIXED_REASONS = (Reason.UNMANAGED, Reason.GIVEN_UP)


def list_file_conflicts(plan: Plan, inventory: Inventory, tasks: Tasks) -> tuple[str, ...]:
    """Differences between a plan and the files, one line each: other files, a host without a sample, a name
    that is unknown, a task with two decisions.
    """
    found = []
    if plan.inventory_digest != inventory.digest:
        other = plan.fleet and plan.fleet != inventory.fleet
        found.append(
            f"it is of fleet {plan.fleet}, this is {inventory.fleet}" if other else "the inventory changed"
        )
    if plan.tasks_digest != tasks.digest:
        found.append("the task files changed")
    probed = {host.name for host in inventory.hosts.values() if host.probe}
    found += [
        f"it has no sample of {name}" for name in sorted(probed - plan.snapshot.hosts.keys(), key=natural_key)
    ]
    counts = Counter(step.task for step in plan.steps)
    found += [f"it decides {count} times on {task}" for task, count in counts.items() if count > 1]
    for step in plan.steps:
        unknown = sorted(_list_step_hosts(step) - inventory.hosts.keys(), key=natural_key)
        found += [f"{name} ({step.action.value} of {step.task}) is not in the inventory" for name in unknown]
        starts = [each for each in step.standbys if each.action is not StandbyAction.STOP]
        if step.task not in tasks.tasks and (starts or step.action not in (Action.STOP, Action.NONE)):
            found.append(f"{step.task} is not in the task files")
    return tuple(found)


def list_unsafe_steps(
    plan: Plan, inventory: Inventory, tasks: Tasks, snapshot: Snapshot, solve: "Solver | None" = None
) -> tuple[str, ...]:
    """Steps that edgectl would not plan for ``snapshot``, newer than the plan, one line each.

    Such a step starts a second copy, uses a host that the rules exclude, stops a task that should run, or
    puts a task elsewhere than a plan of now (ADR 0063). The names in the plan must be known
    (``list_file_conflicts``). Steps that --target or -l left out are not compared. ``solve``: for a plan that
    was made with a solver.
    """
    manager = snapshot.manager or ManagerState()
    policy = replace(plan.policy, full=True)
    fresh = assign(inventory, tasks, snapshot, manager, policy, snapshot.taken_at, solve)
    now = {decision.task: decision for decision in fresh.decisions}
    again = {step.task: step for step in _derive_steps(plan, fresh, tasks, snapshot, manager)}
    return tuple(
        conflict
        for step in plan.steps
        if (
            conflict := (
                _find_conflict(step, again.get(step.task), now.get(step.task))
                if step.action.changes or step.stop
                else None
            )
            or _find_difference(step, now.get(step.task))
            or _find_copy_difference(step, again.get(step.task))
        )
    )


def _list_step_hosts(step: Step) -> set[str]:
    placed = {step.decision.host, step.decision.previous_host} - {None}
    copies = {each.host for each in step.standbys if each.host is not None}
    return {str(host) for host in placed} | {*step.stop, *step.instances} | copies


def _derive_steps(
    plan: Plan, fresh: Assignment, tasks: Tasks, snapshot: Snapshot, manager: ManagerState
) -> Iterator[Step]:
    """The steps of the plan's decisions for what runs now."""
    decisions = tuple(step.decision for step in plan.steps if step.task in tasks.tasks)
    yield from diff_assignment(replace(fresh, decisions=decisions), tasks, snapshot, manager)


def _find_conflict(step: Step, again: Step | None, now: Decision | None) -> str | None:
    """What is wrong with a step; ``again``: the step of its decision for what runs now, ``now``: the decision
    of now.
    """
    if again is None or (again.action, again.instances, again.stop) != (
        step.action,
        step.instances,
        step.stop,
    ):
        places = ", ".join(again.instances) if again is not None and again.instances else ""
        elsewhere = f": it runs on {places}" if places else ""
        return f"{_describe_step(step)} does not fit what runs now{elsewhere}"
    if now is None:
        return None
    if _is_fixed(now) or _is_fixed(step.decision):
        same = (now.verdict, now.reason) == (step.decision.verdict, step.decision.reason)
        return None if same else f"{step.task} is {now.verdict.value} now ({now.reason.value})"
    if step.action in (Action.START, Action.MOVE):
        return _find_rule_conflict(step, now)
    return None


def _find_difference(step: Step, now: Decision | None) -> str | None:
    """The host that a plan of now gives the task, where that is another one."""
    if now is None or step.action is Action.NONE or now.host == step.decision.host:
        return None
    planned = step.decision.host or "no host"
    return f"{step.task}: {planned} in the plan, {now.host or 'no host'} if planned now ({now.reason.value})"


def _find_copy_difference(step: Step, again: Step | None) -> str | None:
    """A copy that a plan of now does not start, stop or activate; ``again``: its step."""
    now = {(each.host, each.action, each.instance) for each in again.standbys} if again is not None else set()
    for each in step.standbys:
        if each.action is not StandbyAction.NONE and (each.host, each.action, each.instance) not in now:
            return f"{each.action.value} of the standby of {step.task} on {each.host} is not planned now"
    return None


def _is_fixed(decision: Decision) -> bool:
    return decision.verdict in _FIXED_VERDICTS or decision.reason in _FIXED_REASONS


def _find_rule_conflict(step: Step, now: Decision) -> str | None:
    """The rule that excludes the planned host; a lack of room is none, because load may differ."""
    ranked = next((each for each in now.ranking if each.host == step.decision.host), None)
    if ranked is None:
        return f"{step.decision.host} is not a candidate for {step.task}"
    rules = [each.rule.value for each in ranked.rejections if each.resource is None]
    return f"{step.decision.host} may not take {step.task} ({', '.join(rules)})" if rules else None


def _describe_step(step: Step) -> str:
    host = f" on {step.decision.host}" if step.decision.host is not None else ""
    return f"{step.action.value} of {step.task}{host}"
