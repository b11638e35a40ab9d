# SPDX-License-Identifier: Apache-2.0
"""Events of what this manager plans and does."""

import dataclasses
from collections.abc import Iterator

from edgectl.model.event import Event, EventKind
from edgectl.model.plan import Action, Plan
from edgectl.model.result import ActionResult, Outcome, Phase, Results
from edgectl.model.snapshot import TaskState
from edgectl.state.store_events import KnownFleet, KnownTask
from edgectl.units import format_duration

_DONE_EVENTS = {
    Action.START: EventKind.TASK_STARTED,
    Action.STOP: EventKind.TASK_STOPPED,
    Action.COMPLETE: EventKind.TASK_STOPPED,
    Action.MOVE: EventKind.TASK_MOVED,
    Action.RESTART: EventKind.TASK_RESTARTED,
    Action.ADOPT: EventKind.TASK_ADOPTED,
}


def detect_result_events(
    known: KnownFleet, results: Results, at: float
) -> tuple[tuple[Event, ...], KnownFleet]:
    """Events of an apply that ended at ``at``, and the new known state."""
    events = [event for result in results.actions for event in _build_result_events(result, at)]
    after = {
        result.task: task
        for result in results.actions
        if (task := _update_known_task(known.tasks.get(result.task), result, at)) is not None
    }
    return tuple(events), dataclasses.replace(known, tasks={**known.tasks, **after})


def _build_result_events(result: ActionResult, at: float) -> Iterator[Event]:
    host = result.host or result.previous_host
    if result.outcome is Outcome.DONE and result.action in _DONE_EVENTS:
        yield Event(
            at=at,
            kind=_DONE_EVENTS[result.action],
            host=host,
            task=result.task,
            message=_describe_result(result),
        )
    elif result.outcome is Outcome.DEFERRED:
        yield Event(
            at=at,
            kind=EventKind.TASK_DEFERRED,
            host=host,
            task=result.task,
            message=f"{result.action}: {result.error}",
        )
    elif result.outcome in (Outcome.FAILED, Outcome.UNREACHABLE):
        yield Event(
            at=at,
            kind=EventKind.ACTION_FAILED,
            host=host,
            task=result.task,
            message=f"{result.action}: {result.error}",
        )


def _describe_result(result: ActionResult) -> str:
    parts = []
    if result.action is Action.MOVE and result.previous_host:
        parts.append(f"from {result.previous_host}")
    if result.action is Action.COMPLETE:
        parts.append("it has completed")
    seconds = sum(phase.seconds for phase in result.phases)
    parts.append(
        f"took {format_duration(seconds)}"
        if result.felt_gap_s is None
        else f"gap {format_duration(result.felt_gap_s)}{'' if result.gap_s is None else ' heard'}"
    )
    parts += [phase.detail for phase in result.phases if phase.ok and phase.detail]
    return ", ".join(parts)


def _update_known_task(before: KnownTask | None, result: ActionResult, at: float) -> KnownTask | None:
    """The task's known state after the action; None if unchanged."""
    touched = result.outcome is Outcome.DONE or (result.outcome is Outcome.FAILED and bool(result.phases))
    if not touched:
        return None
    if result.located is None:
        return KnownTask(at=at, host=None, instance=before.instance if before else "")
    ready = any(phase.phase is Phase.READY and phase.ok for phase in result.phases)
    return KnownTask(at=at, host=result.located, state=TaskState.READY if ready else TaskState.STARTING)


def build_plan_event(plan: Plan) -> Event | None:
    """The event of a plan with changes; None for a plan without."""
    counts = [f"{count} {action}" for action, count in plan.summary.items() if action.changes]
    return Event(at=plan.created_at, kind=EventKind.PLANNED, message=", ".join(counts)) if counts else None


def build_overuse_events(plan: Plan) -> tuple[Event, ...]:
    """Events of the tasks that use more than they declare."""
    return tuple(
        Event(
            at=plan.created_at,
            kind=EventKind.TASK_OVERUSE,
            host=found.host,
            task=found.task,
            message=found.describe(),
        )
        for found in plan.overuses
    )


def build_unplaced_events(plan: Plan) -> tuple[Event, ...]:
    """Events of the unplaced tasks of ``plan``."""
    return tuple(
        Event(
            at=plan.created_at,
            kind=EventKind.TASK_UNPLACED,
            task=step.task,
            message=step.decision.reason.value,
        )
        for step in plan.steps
        if step.action is Action.UNPLACED
    )
