# SPDX-License-Identifier: Apache-2.0
"""Second half of Algorithm 2: carry out a plan, stops first, then starts in the order of ``needs``."""

import time
from collections import Counter
from collections.abc import Mapping

from edgectl.errors import HostError, RefusedError, StateError, describe_unseen_task
from edgectl.executor.action_phases import (
    build_adopt_phases,
    build_stop_phases,
)
from edgectl.executor.cancellation import INTERRUPTED, Cancellation
from edgectl.executor.concurrent_change import ConcurrentChangeError
from edgectl.executor.dependencies import (
    STARTING_ACTIONS,
    STOPPING_ACTIONS,
    StepDependencies,
    build_step_dependencies,
    is_need_satisfied,
    is_replacement,
    list_stop_hosts,
)
from edgectl.executor.handoff import inherit_state, move_task, replace_task, start_instance
from edgectl.executor.phases import perform_phases, resolve_variables
from edgectl.executor.run_options import RunIdentity, RunOptions
from edgectl.executor.standby_run import (
    build_copy_dependencies,
    end_copy_step,
    list_copy_steps,
    list_source_keys,
    perform_copy_step,
)
from edgectl.executor.start_phases import StartPhases, build_start_phases
from edgectl.executor.state_transfer import drop_state
from edgectl.executor.step_run import RunContext, StepRun
from edgectl.executor.stop_budget import BudgetSpentError, StopBudget
from edgectl.executor.worker_pool import WorkerPool
from edgectl.model.assignment import Reason
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.progress import ProgressListener, ignore_progress
from edgectl.model.result import ActionResult, Outcome, Results, StandbyResult
from edgectl.model.task import Task, Tasks
from edgectl.rules.lost_places import describe_lost_place, get_lost_place
from edgectl.state.journal import Journal
from edgectl.transport.base import Transport
from edgectl.transport.fleet_lease import FleetLease
from edgectl.transport.silence import SilenceTransport, SilentHosts

__all__ = ["RunIdentity", "RunOptions", "run_plan"]


def run_plan(
    plan: Plan,
    inventory: Inventory,
    tasks: Tasks,
    transport: Transport,
    journal: Journal,
    identity: RunIdentity,
    options: RunOptions,
    progress: ProgressListener = ignore_progress,
    *,
    lease: FleetLease | None = None,
    silent: SilentHosts | None = None,
) -> Results:
    """Carry out the changes of ``plan`` within ``lease``; the result of each, in the order of the plan.
    ``silent`` receives the hosts that let a deadline pass: only what ends a handoff asks them once more.

    Independent actions run in parallel. The successors of a failed action are skipped, the others go on.
    When ``options.stop_requested`` is set, actions under way are finished and the rest is skipped.
    ``progress`` is called in this thread.

    Raises:
        StateError: the journal cannot be written, so nothing was begun.
    """
    began = time.monotonic()
    silent = SilentHosts() if silent is None else silent
    cancellation = Cancellation(options)
    workers = WorkerPool(options.max_parallel, cancellation.reason, progress)
    shared = RunContext(
        plan=plan,
        inventory=inventory,
        tasks=tasks,
        transport=SilenceTransport(transport, silent),
        recovery=SilenceTransport(transport, silent, recovers=True),
        journal=journal,
        identity=identity,
        options=options,
        report_progress=workers.report_progress,
        lease=lease,
    )
    acts = {
        step.task: StepRun(run=shared, step=step) for step in plan.steps if step.action.changes or step.stop
    }
    _record_begin(shared, acts)
    found, copies = _run_steps(acts, workers, shared, cancellation)
    results = Results(
        revision=identity.revision,
        actions=tuple(found[name] for name in acts),
        seconds=time.monotonic() - began,
        interrupted=any(_was_interrupted(result) for result in found.values())
        or any(_was_interrupted(copy) for copy in copies),
        standbys=copies,
    )
    _record_end(shared, results)
    return results


def _was_interrupted(result: ActionResult | StandbyResult) -> bool:
    return result.outcome is Outcome.SKIPPED and result.error == INTERRUPTED


def _record_begin(shared: RunContext, acts: Mapping[str, StepRun]) -> None:
    shared.journal.append(
        "begin",
        revision=shared.identity.revision,
        plan=shared.identity.plan_id,
        verb=shared.identity.verb,
        user=shared.identity.user,
        actions=len(acts),
        counts=Counter(act.step.action.value for act in acts.values()),
    )


def _record_end(shared: RunContext, results: Results) -> None:
    shared.record(
        "end",
        revision=results.revision,
        interrupted=results.interrupted,
        outcomes=Counter(result.outcome.value for result in results.actions),
        seconds=round(results.seconds, 3),
    )


def _run_steps(
    acts: Mapping[str, StepRun], workers: WorkerPool, shared: RunContext, cancellation: Cancellation
) -> tuple[dict[str, ActionResult], tuple[StandbyResult, ...]]:
    """Stops at once, each start after the stops on its own host: a host that is slow to stop delays no other.
    Inactive copies start at the end.

    With ``fail_fast`` every start waits for every stop. A task whose duplicate could not be stopped is not
    started again. A task that is adopted counts as one that is stopped.
    """
    halting = {_name_stop(name): name for name, act in acts.items() if _list_first_hosts(act.step)}
    waits = build_step_dependencies(shared.plan.steps, shared.tasks)
    after = {key: frozenset[str]() for key in halting} | {
        name: wait.tasks
        | (halting.keys() if shared.options.fail_fast else _list_stops_before(acts[name].step, halting, acts))
        for name, wait in waits.items()
    }
    budget, skipped = StopBudget(), dict[str, ActionResult]()
    copies = list_copy_steps(shared.plan.steps)
    ended = dict[str, StandbyResult]()

    def work(key: str, results: Mapping[str, ActionResult]) -> ActionResult | None:
        if key in copies:
            ended[key] = perform_copy_step(shared, *copies[key], _merge_results(results))
            return None
        if key in halting:
            return cancellation.note_result(_stop_step(acts[halting[key]], budget))
        if _name_stop(key) in results:
            return None
        return cancellation.note_result(_start_step(acts[key], waits[key], _merge_results(results)))

    def skip(key: str) -> ActionResult | None:
        if key in copies:
            why = HostError(cancellation.reason() or INTERRUPTED)
            ended[key] = end_copy_step(*copies[key], Outcome.SKIPPED, why)
            return None
        name = halting.get(key, key)
        if name not in skipped:
            skipped[name] = _end_skipped(acts[name], cancellation.reason() or INTERRUPTED)
        return skipped[name]

    groups = {key: _list_first_hosts(acts[name].step)[0] for key, name in halting.items()}
    starts = {name: acts[name].step for name in waits}
    sources = list_source_keys(shared.plan, shared.tasks)
    found = workers.run_all(build_copy_dependencies(copies, after, starts, sources), work, skip, groups)
    return _merge_results(found), tuple(ended[key] for key in copies)


def _name_stop(name: str) -> str:
    """The key of the stopping part of an action; no task has such a name."""
    return f"{name} stop"


def _list_first_hosts(step: Step) -> tuple[str, ...]:
    """The hosts of the first part of the step: where it stops something, would but is not answered, or adopts
    the task.
    """
    if step.action is Action.ADOPT:
        return (step.decision.host or "", *list_stop_hosts(step))
    unseen = (step.decision.previous_host or "",) if step.action in STOPPING_ACTIONS else ()
    return list_stop_hosts(step) or unseen


def _merge_results(results: Mapping[str, ActionResult]) -> dict[str, ActionResult]:
    """The result of each action; that of its stopping part, where there is one, ended it."""
    return {result.task: result for result in reversed(list(results.values()))}


def _list_stops_before(step: Step, halting: Mapping[str, str], acts: Mapping[str, StepRun]) -> frozenset[str]:
    """The stops that a start waits for: of its own task, and on the host to which it comes."""
    return frozenset(
        key
        for key, name in halting.items()
        if name == step.task or step.decision.host in _list_first_hosts(acts[name].step)
    )


def _stop_step(act: StepRun, budget: StopBudget) -> ActionResult | None:
    """Stop the task where the step says so, and adopt it where it is kept; no result yet where the step goes
    on to start it elsewhere.
    """
    decision = act.step.decision
    here = decision.previous_host if act.step.action in STOPPING_ACTIONS else decision.host
    try:
        if decision.reason is Reason.LEFT_FILE:
            budget.check(list_stop_hosts(act.step)[0])
        act.begin()
        perform_phases(act, build_stop_phases(act.step, act.run.inventory, act.run.tasks))
        adoption = build_adopt_phases(act.step, act.run.inventory, act.run.tasks)
        if adoption and act.task is not None:
            perform_phases(act, adoption, resolve_variables(act, act.task, decision.host or ""))
    except StateError as error:
        return _end_unrecorded(act, error)
    except ConcurrentChangeError as error:
        return act.end(Outcome.DEFERRED, located=error.located, error=error)
    except BudgetSpentError as error:
        return act.end(Outcome.DEFERRED, located=here, error=error)
    except HostError as error:
        return act.end(Outcome.FAILED, located=here, error=error)
    if act.step.action in STARTING_ACTIONS:
        return None
    unseen = _find_unseen_stop_error(act) if act.step.action is Action.STOP else None
    if unseen is not None:
        return act.end(Outcome.UNREACHABLE, located=here, error=unseen)
    return act.end(Outcome.DONE, located=None if act.step.action in STOPPING_ACTIONS else here)


def _find_unseen_stop_error(act: StepRun) -> HostError | None:
    """Why a task that may run on was not stopped; None where every instance was seen."""
    decision = act.step.decision
    host, lost = decision.previous_host or "", get_lost_place(decision)
    if lost is not None:
        return HostError(f"not stopped: {act.name} {describe_lost_place(lost)}", host=host)
    if decision.reason is not Reason.HOST_SILENT:
        return None
    return HostError(
        f"not stopped: {describe_unseen_task(act.name, host)}",
        hint=f"stop it again once {host} answers; if {host} is powered off: edgectl fence {host}",
        host=host,
    )


def _start_step(act: StepRun, waits: StepDependencies, results: Mapping[str, ActionResult]) -> ActionResult:
    """Start, move or restart, once what it waits for has gone well."""
    decision, task = act.step.decision, act.task
    failed = [need.task for need in waits.needs if not is_need_satisfied(need, results.get(need.task))]
    if failed:
        return _end_skipped(act, f"needs {failed[0]}, which did not start")
    if task is None or decision.host is None:
        return _end_skipped(act, "the task is no longer in the files")
    try:
        planned = build_start_phases(
            act.step, task, (*waits.needs, *waits.others), act.run.plan, act.run.inventory, act.run.tasks
        )
        perform_phases(act, planned.needs)
        act.begin()
    except HostError as error:
        return act.end(Outcome.DEFERRED, located=decision.previous_host, error=error)
    except StateError as error:
        return _end_unrecorded(act, error)
    if is_replacement(act.step):
        return replace_task(act, task, planned)
    if act.step.action is Action.START:
        return _start_new_task(act, task, planned, decision.host)
    return move_task(act, task, planned)


def _start_new_task(act: StepRun, task: Task, planned: StartPhases, host: str) -> ActionResult:
    """Start and wait until ready. A task that is not ready in time is left running: it may only be slow.

    Once a start was sent its reply may be lost, so the task counts as there until its host reports otherwise:
    it must never run twice.
    """
    located = None
    try:
        perform_phases(act, planned.prepare)
        variables = resolve_variables(act, task, host)
        change = inherit_state(act, task, planned, host)
        located = host
        start_instance(act, task, change, host, variables)
    except RefusedError as error:
        drop_state(act)
        return act.end(Outcome.FAILED, located=None, error=error)
    except HostError as error:
        drop_state(act)
        return act.end(Outcome.FAILED, located=located, error=error)
    drop_state(act)
    return act.end(Outcome.DONE, located=host)


def _end_skipped(act: StepRun, reason: str) -> ActionResult:
    return act.end(Outcome.SKIPPED, located=act.step.decision.previous_host, error=HostError(reason))


def _end_unrecorded(act: StepRun, error: StateError) -> ActionResult:
    """The intent could not be written: the action was not begun, and no other may begin."""
    act.run.options.stop_requested.set()
    return act.end(
        Outcome.FAILED,
        located=act.step.decision.previous_host,
        error=HostError(error.message, hint=error.hint),
    )
