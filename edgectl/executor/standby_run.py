# SPDX-License-Identifier: Apache-2.0
"""Start and stop inactive copies: stops come before everything that starts, starts after everything."""

import dataclasses
import time
from collections.abc import Iterable, Iterator, Mapping

from edgectl.errors import HostError, StateError
from edgectl.executor.dependencies import STARTING_ACTIONS
from edgectl.executor.phases import perform_phases
from edgectl.executor.standby_phases import build_copy_phases, find_heir_source
from edgectl.executor.step_run import RunContext, StepRun
from edgectl.model.plan import Plan, Step
from edgectl.model.progress import ignore_progress
from edgectl.model.result import ActionResult, Outcome, StandbyResult
from edgectl.model.standby_plan import StandbyAction, StandbyStep
from edgectl.model.task import Tasks

CopySteps = Mapping[str, tuple[Step, StandbyStep]]


def list_copy_steps(steps: Iterable[Step]) -> dict[str, tuple[Step, StandbyStep]]:
    """The copies that a plan starts or stops by themselves, by a name that no task has."""
    return dict(_name_copy_steps(steps))


def _name_copy_steps(steps: Iterable[Step]) -> Iterator[tuple[str, tuple[Step, StandbyStep]]]:
    for step in steps:
        for copy in step.standbys:
            if copy.action.changes and copy.host is not None:
                yield _name_copy(step.task, copy.host), (step, copy)


def list_source_keys(plan: Plan, tasks: Tasks) -> frozenset[str]:
    """The copies, by their names in `list_copy_steps`, from which a task that starts gets its state."""
    found = (
        (step.task, find_heir_source(plan, step, task))
        for step in plan.steps
        if (task := tasks.tasks.get(step.task)) is not None
    )
    return frozenset(_name_copy(name, source[0]) for name, source in found if source is not None)


def _name_copy(task: str, host: str) -> str:
    return f"{task} copy {host}"


def build_copy_dependencies(
    copies: CopySteps,
    after: Mapping[str, frozenset[str]],
    starts: Mapping[str, Step],
    sources: frozenset[str] = frozenset(),
) -> dict[str, frozenset[str]]:
    """``after`` with the copies: starts wait for copies that stop for their sake; copies that start wait for
    everything else.

    ``starts``: the steps in ``after`` that start a task, by name. ``sources``: copies that stop only after
    their task, which gets its state from them, has started.
    """
    stops = {key for key, (_, copy) in copies.items() if copy.action is StandbyAction.STOP} - sources
    found = {
        name: others | {key for key in stops if _makes_way(copies[key], starts[name])}
        if name in starts
        else others
        for name, others in after.items()
    }
    last = sources & copies.keys()
    everything = frozenset(after) | stops | last
    waits = {key: frozenset[str]() if key in stops else everything for key in copies}
    return found | waits | {key: frozenset({copies[key][0].task}) & starts.keys() for key in last}


def _makes_way(stopped: tuple[Step, StandbyStep], start: Step) -> bool:
    step, copy = stopped
    return step.task == start.task or copy.host == start.decision.host


def perform_copy_step(
    run: RunContext, step: Step, copy: StandbyStep, results: Mapping[str, ActionResult]
) -> StandbyResult:
    """Start or stop one copy. ``results``: of the actions on tasks that have ended.

    A copy from which its task should have got its state stays where that has not become active.
    """
    result, waits = results.get(step.task), step.action in STARTING_ACTIONS
    waits = waits or copy.action is not StandbyAction.STOP
    if waits and result is not None and result.outcome is not Outcome.DONE:
        why = HostError(f"{step.task} is not where the plan has it")
        return end_copy_step(step, copy, Outcome.SKIPPED, why)
    began = time.monotonic()
    act = StepRun(run=dataclasses.replace(run, report_progress=ignore_progress), step=step)
    error, outcome = None, Outcome.DONE
    try:
        generation = {} if copy.action is StandbyAction.STOP else {"generation": act.generation}
        run.journal.append("copy", task=step.task, host=copy.host, action=copy.action.value, **generation)
        perform_phases(act, build_copy_phases(step, copy, run.inventory, run.tasks))
    except StateError as failed:
        run.options.stop_requested.set()
        error, outcome = HostError(failed.message, hint=failed.hint), Outcome.FAILED
    except HostError as failed:
        error, outcome = failed, Outcome.FAILED
    ended = end_copy_step(step, copy, outcome, error, time.monotonic() - began, act.started)
    run.record(
        "copied",
        task=step.task,
        host=copy.host,
        action=copy.action.value,
        outcome=outcome.value,
        seconds=round(ended.seconds, 4),
        error=ended.error,
    )
    return ended


def end_copy_step(
    step: Step,
    copy: StandbyStep,
    outcome: Outcome,
    error: HostError | None = None,
    seconds: float = 0.0,
    instance: str = "",
) -> StandbyResult:
    """The result of one copy."""
    return StandbyResult(
        task=step.task,
        host=copy.host or "",
        action=copy.action,
        outcome=outcome,
        seconds=seconds,
        error=error.message if error is not None else "",
        hint=error.hint if error is not None else "",
        instance=instance,
    )
