"""Carry out a plan: stops first, then starts in the order of ``needs``, independent actions in parallel (Algorithm 2)."""

import time
from collections import Counter
from collections.abc import Mapping

from edgectl.errors import HostError, RefusedError, StateError
from edgectl.executor import phases
from edgectl.executor.act import Act, Run, RunOptions
from edgectl.executor.brake import INTERRUPTED, Brake
from edgectl.executor.crew import Crew
from edgectl.executor.handoff import move, replace
from edgectl.executor.order import STARTING, STOPPING, Waits, order, replaces, stops
from edgectl.executor.predecessors import await_others, satisfied
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan
from edgectl.model.progress import Listener, unheard
from edgectl.model.result import ActionResult, Outcome, Results
from edgectl.model.task import Tasks
from edgectl.state.journal import Journal
from edgectl.transport.base import Transport

__all__ = ["RunOptions", "run"]


def run(
    plan: Plan,
    inventory: Inventory,
    tasks: Tasks,
    transport: Transport,
    journal: Journal,
    options: RunOptions,
    progress: Listener = unheard,
) -> Results:
    """Carry out the changes of ``plan`` and say how each went, in the order of the plan.

    A failed action costs its successors (skipped), never the others. When ``options.stop_requested`` is set, what has
    begun is finished and the rest is skipped. ``progress`` is called in this thread.

    Raises:
        StateError: the journal cannot be written, so nothing was begun.
    """
    began = time.monotonic()
    brake = Brake(options.stop_requested, fail_fast=options.fail_fast, deadline=options.deadline)
    crew = Crew(options.max_parallel, brake.reason, progress)
    shared = Run(plan=plan, inventory=inventory, tasks=tasks, transport=transport, journal=journal, options=options, tell=crew.tell)
    acts = {step.task: Act(run=shared, step=step) for step in plan.steps if step.action.changes or step.stop}
    counts = Counter(act.step.action.value for act in acts.values())
    journal.append(
        "begin", revision=options.revision, plan=options.plan_id, verb=options.verb, user=options.user, actions=len(acts), counts=counts
    )
    results = _carried_out(acts, crew, shared, brake)
    interrupted = any(result.outcome is Outcome.SKIPPED and result.error == INTERRUPTED for result in results.values())
    outcomes = Counter(result.outcome.value for result in results.values())
    shared.record("end", revision=options.revision, interrupted=interrupted, outcomes=outcomes, seconds=round(time.monotonic() - began, 3))
    return Results(
        revision=options.revision,
        actions=tuple(results[name] for name in acts),
        seconds=time.monotonic() - began,
        interrupted=interrupted,
    )


def _carried_out(acts: Mapping[str, Act], crew: Crew, shared: Run, brake: Brake) -> dict[str, ActionResult]:
    """First all that stops, then all that starts; a task whose duplicate could not be stopped is not started again."""

    def skip(name: str) -> ActionResult:
        return _skipped(acts[name], brake.reason() or INTERRUPTED)

    halting = {name: frozenset[str]() for name, act in acts.items() if act.step.action in STOPPING or act.step.stop}
    halted = crew.work(halting, lambda name, _results: brake.seen(_halt(acts[name])), skip)
    waits = order(shared.plan.steps, shared.tasks)
    after = {name: wait.tasks - halted.keys() for name, wait in waits.items() if name not in halted}
    started = crew.work(after, lambda name, results: brake.seen(_perform(acts[name], waits[name], {**halted, **results})), skip)
    return halted | started


def _halt(act: Act) -> ActionResult | None:
    """Stop the task where the step says so; no result yet where the step goes on to start it elsewhere."""
    decision = act.step.decision
    here = decision.previous_host if act.step.action in STOPPING else decision.host
    try:
        act.begin()
        for host in stops(act.step):
            phases.stop(act, host, instance=act.step.instances.get(host))
    except StateError as error:
        return _unrecorded(act, error)
    except HostError as error:
        return act.end(Outcome.FAILED, located=here, error=error)
    if act.step.action in STARTING:
        return None
    return act.end(Outcome.DONE, located=None if act.step.action in STOPPING else here)


def _perform(act: Act, waits: Waits, results: Mapping[str, ActionResult]) -> ActionResult:
    """Start, move or restart, once what it waits for has gone well."""
    decision, task = act.step.decision, act.task
    failed = [need.task for need in waits.needs if not satisfied(need, results.get(need.task))]
    if failed:
        return _skipped(act, f"needs {failed[0]}, which did not start")
    if task is None or decision.host is None:
        return _skipped(act, "the task is not in the files any more")
    try:
        await_others(act.run, (*waits.needs, *waits.others))
        act.begin()
    except HostError as error:
        return act.end(Outcome.DEFERRED, located=decision.previous_host, error=error)
    except StateError as error:
        return _unrecorded(act, error)
    if replaces(act.step):
        return replace(act, task, decision.host)
    if act.step.action is Action.START:
        return _start(act, decision.host)
    return move(act, task, decision.previous_host or decision.host, decision.host)


def _start(act: Act, host: str) -> ActionResult:
    """Start and wait until ready. What is not ready in time is left running: it may only be slow.

    Once a start was sent its answer may be lost, so the task counts as there until its host says otherwise: it must never be doubled.
    """
    task = act.run.tasks.tasks[act.name]
    located = None
    try:
        phases.reach(act.run, host)
        variables = phases.variables(act, task, host)
        located = host
        phases.await_ready(act, task, host, phases.start(act, task, host, variables))
    except RefusedError as error:
        return act.end(Outcome.FAILED, located=None, error=error)
    except HostError as error:
        return act.end(Outcome.FAILED, located=located, error=error)
    return act.end(Outcome.DONE, located=host)


def _skipped(act: Act, reason: str) -> ActionResult:
    return act.end(Outcome.SKIPPED, located=act.step.decision.previous_host, error=HostError(reason))


def _unrecorded(act: Act, error: StateError) -> ActionResult:
    """The intent could not be written: the action was not begun, and no other may begin."""
    act.run.options.stop_requested.set()
    return act.end(Outcome.FAILED, located=act.step.decision.previous_host, error=HostError(error.message, hint=error.hint))
