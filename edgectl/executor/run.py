"""Carry out a plan: stops first, then starts in the order of ``needs``, independent actions in parallel (Algorithm 2)."""

import time
from collections import Counter
from collections.abc import Mapping

from edgectl.errors import HostError, RefusedError, StateError
from edgectl.executor import phases
from edgectl.executor.cancellation import INTERRUPTED, Cancellation
from edgectl.executor.dependencies import (
    STARTING_ACTIONS,
    STOPPING_ACTIONS,
    StepDependencies,
    build_step_dependencies,
    is_replacement,
    list_stop_hosts,
)
from edgectl.executor.handoff import move_task, replace_task
from edgectl.executor.predecessors import is_need_satisfied, wait_for_predecessors
from edgectl.executor.step_run import RunContext, RunOptions, StepRun
from edgectl.executor.worker_pool import WorkerPool
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan
from edgectl.model.progress import ProgressListener, ignore_progress
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.model.task import Tasks
from edgectl.state.journal import Journal
from edgectl.transport.base import Transport

__all__ = ["RunOptions", "run_plan"]


def run_plan(
    plan: Plan,
    inventory: Inventory,
    tasks: Tasks,
    transport: Transport,
    journal: Journal,
    options: RunOptions,
    progress: ProgressListener = ignore_progress,
) -> Results:
    """Carry out the changes of ``plan`` and say how each went, in the order of the plan.

    A failed action costs its successors (skipped), never the others. When ``options.stop_requested`` is set, what has
    begun is finished and the rest is skipped. ``progress`` is called in this thread.

    Raises:
        StateError: the journal cannot be written, so nothing was begun.
    """
    began = time.monotonic()
    brake = Cancellation(options.stop_requested, fail_fast=options.fail_fast, deadline=options.deadline)
    crew = WorkerPool(options.max_parallel, brake.reason, progress)
    shared = RunContext(
        plan=plan,
        inventory=inventory,
        tasks=tasks,
        transport=transport,
        journal=journal,
        options=options,
        report_progress=crew.report_progress,
    )
    acts = {
        step.task: StepRun(run=shared, step=step) for step in plan.steps if step.action.changes or step.stop
    }
    counts = Counter(act.step.action.value for act in acts.values())
    journal.append(
        "begin",
        revision=options.revision,
        plan=options.plan_id,
        verb=options.verb,
        user=options.user,
        actions=len(acts),
        counts=counts,
    )
    results = _run_steps(acts, crew, shared, brake)
    interrupted = any(
        result.outcome is Outcome.SKIPPED and result.error == INTERRUPTED for result in results.values()
    )
    outcomes = Counter(result.outcome.value for result in results.values())
    shared.record(
        "end",
        revision=options.revision,
        interrupted=interrupted,
        outcomes=outcomes,
        seconds=round(time.monotonic() - began, 3),
    )
    return Results(
        revision=options.revision,
        actions=tuple(results[name] for name in acts),
        seconds=time.monotonic() - began,
        interrupted=interrupted,
    )


def _run_steps(
    acts: Mapping[str, StepRun], crew: WorkerPool, shared: RunContext, brake: Cancellation
) -> dict[str, ActionResult]:
    """First all that stops, then all that starts; a task whose duplicate could not be stopped is not started again."""

    def skip(name: str) -> ActionResult:
        return _end_skipped(acts[name], brake.reason() or INTERRUPTED)

    halting = {
        name: frozenset[str]()
        for name, act in acts.items()
        if act.step.action in STOPPING_ACTIONS or act.step.stop
    }
    halted = crew.run_all(halting, lambda name, _results: brake.seen(_stop_step(acts[name])), skip)
    waits = build_step_dependencies(shared.plan.steps, shared.tasks)
    after = {name: wait.tasks - halted.keys() for name, wait in waits.items() if name not in halted}
    started = crew.run_all(
        after,
        lambda name, results: brake.seen(_start_step(acts[name], waits[name], {**halted, **results})),
        skip,
    )
    return halted | started


def _stop_step(act: StepRun) -> ActionResult | None:
    """Stop the task where the step says so; no result yet where the step goes on to start it elsewhere."""
    decision = act.step.decision
    here = decision.previous_host if act.step.action in STOPPING_ACTIONS else decision.host
    try:
        act.begin()
        for host in list_stop_hosts(act.step):
            phases.stop_task(act, host, instance=act.step.instances.get(host))
    except StateError as error:
        return _end_unrecorded(act, error)
    except HostError as error:
        return act.end(Outcome.FAILED, located=here, error=error)
    if act.step.action in STARTING_ACTIONS:
        return None
    return act.end(Outcome.DONE, located=None if act.step.action in STOPPING_ACTIONS else here)


def _start_step(act: StepRun, waits: StepDependencies, results: Mapping[str, ActionResult]) -> ActionResult:
    """Start, move or restart, once what it waits for has gone well."""
    decision, task = act.step.decision, act.task
    failed = [need.task for need in waits.needs if not is_need_satisfied(need, results.get(need.task))]
    if failed:
        return _end_skipped(act, f"needs {failed[0]}, which did not start")
    if task is None or decision.host is None:
        return _end_skipped(act, "the task is not in the files any more")
    try:
        wait_for_predecessors(act.run, (*waits.needs, *waits.others))
        act.begin()
    except HostError as error:
        return act.end(Outcome.DEFERRED, located=decision.previous_host, error=error)
    except StateError as error:
        return _end_unrecorded(act, error)
    if is_replacement(act.step):
        return replace_task(act, task, decision.host)
    if act.step.action is Action.START:
        return _start_new_task(act, decision.host)
    return move_task(act, task, decision.previous_host or decision.host, decision.host)


def _start_new_task(act: StepRun, host: str) -> ActionResult:
    """Start and wait until ready. What is not ready in time is left running: it may only be slow.

    Once a start was sent its answer may be lost, so the task counts as there until its host says otherwise: it must never be doubled.
    """
    task = act.run.tasks.tasks[act.name]
    located = None
    try:
        phases.check_reachable(act.run, host)
        variables = phases.resolve_variables(act, task, host)
        located = host
        phases.wait_for_ready(act, task, host, phases.start_task(act, task, host, variables))
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
