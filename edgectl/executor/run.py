"""Second half of Algorithm 2: carry out a plan, stops first, then starts in the order of ``needs``."""

import time
from collections import Counter
from collections.abc import Mapping

from edgectl.errors import HostError, RefusedError, StateError, describe_unseen_task
from edgectl.executor.action_phases import (
    StartPhases,
    build_adopt_phases,
    build_start_phases,
    build_stop_phases,
)
from edgectl.executor.cancellation import INTERRUPTED, Cancellation
from edgectl.executor.dependencies import (
    STARTING_ACTIONS,
    STOPPING_ACTIONS,
    StepDependencies,
    build_step_dependencies,
    is_need_satisfied,
    is_replacement,
)
from edgectl.executor.handoff import move_task, replace_task
from edgectl.executor.moved_world import MovedWorldError
from edgectl.executor.phases import perform_phases, resolve_variables
from edgectl.executor.step_run import RunContext, RunIdentity, RunOptions, StepRun
from edgectl.executor.worker_pool import WorkerPool
from edgectl.model.assignment import Reason
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan
from edgectl.model.progress import ProgressListener, ignore_progress
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.model.task import Task, Tasks
from edgectl.state.journal import Journal
from edgectl.transport.base import Transport
from edgectl.transport.fleet_lease import FleetLease

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
) -> Results:
    """Carry out the changes of ``plan`` within ``lease``; the result of each, in the order of the plan.

    Independent actions run in parallel. The successors of a failed action are skipped, the others go on.
    When ``options.stop_requested`` is set, actions under way are finished and the rest is skipped.
    ``progress`` is called in this thread.

    Raises:
        StateError: the journal cannot be written, so nothing was begun.
    """
    began = time.monotonic()
    cancellation = Cancellation(options)
    workers = WorkerPool(options.max_parallel, cancellation.reason, progress)
    shared = RunContext(
        plan=plan,
        inventory=inventory,
        tasks=tasks,
        transport=transport,
        journal=journal,
        identity=identity,
        options=options,
        report_progress=workers.report_progress,
        lease=lease,
    )
    acts = {
        step.task: StepRun(run=shared, step=step) for step in plan.steps if step.action.changes or step.stop
    }
    counts = Counter(act.step.action.value for act in acts.values())
    journal.append(
        "begin",
        revision=identity.revision,
        plan=identity.plan_id,
        verb=identity.verb,
        user=identity.user,
        actions=len(acts),
        counts=counts,
    )
    results = _run_steps(acts, workers, shared, cancellation)
    interrupted = any(
        result.outcome is Outcome.SKIPPED and result.error == INTERRUPTED for result in results.values()
    )
    outcomes = Counter(result.outcome.value for result in results.values())
    shared.record(
        "end",
        revision=identity.revision,
        interrupted=interrupted,
        outcomes=outcomes,
        seconds=round(time.monotonic() - began, 3),
    )
    return Results(
        revision=identity.revision,
        actions=tuple(results[name] for name in acts),
        seconds=time.monotonic() - began,
        interrupted=interrupted,
    )


def _run_steps(
    acts: Mapping[str, StepRun], workers: WorkerPool, shared: RunContext, cancellation: Cancellation
) -> dict[str, ActionResult]:
    """All stops, then all starts; a task whose duplicate could not be stopped is not started again."""

    def skip(name: str) -> ActionResult:
        return _end_skipped(acts[name], cancellation.reason() or INTERRUPTED)

    halting = {
        name: frozenset[str]()
        for name, act in acts.items()
        if act.step.action in (*STOPPING_ACTIONS, Action.ADOPT) or act.step.stop
    }
    halted = workers.run_all(
        halting, lambda name, _results: cancellation.note_result(_stop_step(acts[name])), skip
    )
    waits = build_step_dependencies(shared.plan.steps, shared.tasks)
    after = {name: wait.tasks - halted.keys() for name, wait in waits.items() if name not in halted}
    started = workers.run_all(
        after,
        lambda name, results: cancellation.note_result(
            _start_step(acts[name], waits[name], {**halted, **results})
        ),
        skip,
    )
    return halted | started


def _stop_step(act: StepRun) -> ActionResult | None:
    """Stop the task where the step says so, and adopt it where it is kept; no result yet where the step goes
    on to start it elsewhere.
    """
    decision = act.step.decision
    here = decision.previous_host if act.step.action in STOPPING_ACTIONS else decision.host
    try:
        act.begin()
        perform_phases(act, build_stop_phases(act.step, act.run.inventory, act.run.tasks))
        adoption = build_adopt_phases(act.step, act.run.inventory, act.run.tasks)
        if adoption and act.task is not None:
            perform_phases(act, adoption, resolve_variables(act, act.task, decision.host or ""))
    except StateError as error:
        return _end_unrecorded(act, error)
    except MovedWorldError as error:
        return act.end(Outcome.DEFERRED, located=error.located, error=error)
    except HostError as error:
        return act.end(Outcome.FAILED, located=here, error=error)
    if act.step.action in STARTING_ACTIONS:
        return None
    if act.step.action is Action.STOP and decision.reason is Reason.HOST_SILENT:
        return act.end(
            Outcome.UNREACHABLE, located=here, error=_build_silent_stop_error(act.name, here or "")
        )
    return act.end(Outcome.DONE, located=None if act.step.action in STOPPING_ACTIONS else here)


def _build_silent_stop_error(task: str, host: str) -> HostError:
    return HostError(
        f"not stopped: {describe_unseen_task(task, host)}",
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

    Once a start was sent its reply may be lost, so the task counts as there until its host denies it:
    it must never be doubled.
    """
    located = None
    try:
        perform_phases(act, planned.prepare)
        variables = resolve_variables(act, task, host)
        located = host
        perform_phases(act, planned.change, variables)
    except RefusedError as error:
        return act.end(Outcome.FAILED, located=None, error=error)
    except HostError as error:
        return act.end(Outcome.FAILED, located=located, error=error)
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
