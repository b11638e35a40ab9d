# SPDX-License-Identifier: Apache-2.0
"""Exit codes of results (docs/cli.md, "Exit codes")."""

from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

from edgectl.errors import ExitCode
from edgectl.model.assignment import Reason
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan
from edgectl.model.profiler import Profiler, ProfilerState
from edgectl.model.snapshot import Snapshot, find_doubled_tasks
from edgectl.model.task import Tasks
from edgectl.rules.lost_places import list_lost_tasks
from edgectl.rules.other_managers import list_tasks_on_unlisted_hosts

if TYPE_CHECKING:
    from edgectl.model.byte_counters import ByteCounters
    from edgectl.model.cycle import Cycle
    from edgectl.model.diagnosis import Diagnosis
    from edgectl.rules.awaited_state import TaskProgress
    from edgectl.usecases.plan_execution import ApplyResult

_MILDER_CODES = (ExitCode.DONE, ExitCode.CHANGES, ExitCode.UNPLACED)


def of_snapshot(snapshot: Snapshot, inventory: Inventory, *, allow_unreachable: bool = False) -> ExitCode:
    """4 if a host that should answer did not, a task runs twice, or one is where the inventory no longer
    reaches it.
    """
    silent = any(name in inventory.hosts for name in snapshot.silent_hosts)
    wrong = _has_misplaced_tasks(snapshot) or (silent and not allow_unreachable)
    return ExitCode.PARTLY if wrong else ExitCode.DONE


def _has_misplaced_tasks(snapshot: Snapshot) -> bool:
    """Whether a task runs twice, or where the inventory no longer reaches it."""
    return bool(find_doubled_tasks(snapshot) or list_lost_tasks(snapshot))


def of_counters(counters: "Iterable[ByteCounters]") -> ExitCode:
    """4 if a host did not do what was asked, or has counters that cannot be read."""
    failed = any(each.error or (each.state and not each.installed) for each in counters)
    return ExitCode.PARTLY if failed else ExitCode.DONE


def of_profilers(profilers: Iterable[Profiler]) -> ExitCode:
    """4 if a host did not answer."""
    return (
        ExitCode.PARTLY
        if any(each.state is ProfilerState.UNREACHABLE for each in profilers)
        else ExitCode.DONE
    )


def of_plan(plan: Plan, *, detailed: bool, allow_unreachable: bool) -> ExitCode:
    """4 beats 3 beats 2; 2 and 3 only with --detailed-exitcode."""
    if list_lost_tasks(plan.snapshot) or list_tasks_on_unlisted_hosts(plan):
        return ExitCode.PARTLY
    if not allow_unreachable and plan.snapshot.silent_hosts:
        return ExitCode.PARTLY
    if detailed and Action.UNPLACED in plan.summary:
        return ExitCode.UNPLACED
    return ExitCode.CHANGES if detailed and plan.changes else ExitCode.DONE


def of_applied(
    applied: "ApplyResult", *, detailed: bool = False, allow_unreachable: bool = False
) -> ExitCode:
    """1 if declined, 130 if interrupted, 4 if an action failed or was deferred or a task runs twice;
    unreachable hosts and unplaced tasks as in a plan.
    """
    code = _of_actions(applied) or of_plan(
        applied.plan, detailed=detailed, allow_unreachable=allow_unreachable
    )
    return ExitCode.DONE if code is ExitCode.CHANGES else code


def _of_actions(applied: "ApplyResult") -> ExitCode:
    """1 if declined, 130 if interrupted, 4 if an action failed or was deferred or a task runs twice."""
    results = applied.results
    if applied.declined:
        return ExitCode.FAILED
    if applied.doubled and (results is None or not results.interrupted):
        return ExitCode.PARTLY
    if results is not None and not results.done:
        return ExitCode.INTERRUPTED if results.interrupted else ExitCode.PARTLY
    return ExitCode.DONE


def of_named(applied: "ApplyResult", names: Collection[str] | None) -> ExitCode:
    """As ``of_applied`` for a stop or restart of ``names`` (None: all tasks). Silent hosts and lost places
    count only if the answer depends on them: all tasks were meant, or one that no host reports.
    """
    planned = {step.task for step in applied.plan.steps}
    depends = names is None or not planned.issuperset(names)
    return of_applied(applied) if depends else _of_actions(applied)


def worsen_if_given_up(code: ExitCode, plan: Plan) -> ExitCode:
    """4 instead of 0, 2 or 3 while a wanted task is given up."""
    lasting = any(step.decision.reason is Reason.GIVEN_UP for step in plan.steps)
    return ExitCode.PARTLY if lasting and code in _MILDER_CODES else code


def of_status(
    snapshot: Snapshot, inventory: Inventory, tasks: Tasks, *, allow_unreachable: bool = False
) -> ExitCode:
    """4 if a host that should answer did not, or a wanted task has failed, is not alive, or is cut off from
    its robot.
    """
    from edgectl.rules.cut_off import list_cut_off_tasks
    from edgectl.views.state import find_failed_tasks, list_unhealthy_tasks

    cut_off = any(list_cut_off_tasks(tasks, snapshot))
    if find_failed_tasks(tasks, snapshot) or list_unhealthy_tasks(snapshot) or cut_off:
        return ExitCode.PARTLY
    return of_snapshot(snapshot, inventory, allow_unreachable=allow_unreachable)


def of_wait(progress: "Sequence[TaskProgress]", *, interrupted: bool) -> ExitCode:
    """1 if a task has not reached what was waited for, 130 if the wait was interrupted before."""
    if all(each.reached for each in progress):
        return ExitCode.DONE
    return ExitCode.INTERRUPTED if interrupted else ExitCode.FAILED


def of_cycle(cycle: "Cycle") -> ExitCode:
    """1 if the cycle failed, 75 if the lock was busy, 4 if an action failed, a host did not answer, a task
    runs twice or may run on a host that the inventory lacks, or a wanted task is given up.
    """
    if cycle.error:
        return ExitCode.FAILED
    if cycle.busy:
        return ExitCode.TRY_AGAIN
    failed = cycle.results is not None and not cycle.results.done
    failed = failed or bool(list_tasks_on_unlisted_hosts(cycle.plan))
    seen = cycle.snapshot
    wrong = failed or (seen is not None and bool(seen.silent_hosts or _has_misplaced_tasks(seen)))
    code = ExitCode.PARTLY if wrong else ExitCode.DONE
    return code if cycle.plan is None else worsen_if_given_up(code, cycle.plan)


def of_diagnosis(diagnosis: "Diagnosis") -> ExitCode:
    """1 if a check failed."""
    from edgectl.model.diagnosis import Severity

    return ExitCode.FAILED if diagnosis.worst is Severity.FAILED else ExitCode.DONE
