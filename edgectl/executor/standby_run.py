# SPDX-License-Identifier: Apache-2.0
"""Start and stop inactive copies: stops come before everything that starts, starts after everything."""

import dataclasses
import time
from collections.abc import Iterable, Iterator, Mapping

from edgectl.errors import HostError, StateError
from edgectl.executor.phases import perform_phases
from edgectl.executor.standby_phases import build_copy_phases
from edgectl.executor.step_run import RunContext, StepRun
from edgectl.model.plan import Step
from edgectl.model.progress import ignore_progress
from edgectl.model.result import ActionResult, Outcome, StandbyResult
from edgectl.model.standby_plan import StandbyAction, StandbyStep

CopySteps = Mapping[str, tuple[Step, StandbyStep]]


def list_copy_steps(steps: Iterable[Step]) -> dict[str, tuple[Step, StandbyStep]]:
    """The copies that a plan starts or stops by themselves, by a name that no task has."""
    return dict(_name_copy_steps(steps))


def _name_copy_steps(steps: Iterable[Step]) -> Iterator[tuple[str, tuple[Step, StandbyStep]]]:
    for step in steps:
        for copy in step.standbys:
            if copy.action.changes and copy.host is not None:
                yield f"{step.task} copy {copy.host}", (step, copy)


def build_copy_dependencies(
    copies: CopySteps, after: Mapping[str, frozenset[str]], starts: Mapping[str, Step]
) -> dict[str, frozenset[str]]:
    """``after`` with the copies: starts wait for copies that stop for their sake; copies that start wait for
    everything else.

    ``starts``: the steps in ``after`` that start a task, by name.
    """
    stops = {key for key, (_, copy) in copies.items() if copy.action is StandbyAction.STOP}
    found = {
        name: others | {key for key in stops if _makes_way(copies[key], starts[name])}
        if name in starts
        else others
        for name, others in after.items()
    }
    everything = frozenset(after) | stops
    return found | {key: frozenset[str]() if key in stops else everything for key in copies}


def _makes_way(stopped: tuple[Step, StandbyStep], start: Step) -> bool:
    step, copy = stopped
    return step.task == start.task or copy.host == start.decision.host


def perform_copy_step(
    run: RunContext, step: Step, copy: StandbyStep, results: Mapping[str, ActionResult]
) -> StandbyResult:
    """Start or stop one copy. ``results``: of the actions on tasks that have ended."""
    result = results.get(step.task)
    if copy.action is not StandbyAction.STOP and result is not None and result.outcome is not Outcome.DONE:
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
