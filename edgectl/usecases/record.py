"""Best-effort recording of samples, plans and results; a failure is one warning, never an error."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from edgectl.model.event import Event
from edgectl.model.plan import Plan
from edgectl.model.result import Results
from edgectl.model.snapshot import Snapshot, TaskSample
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.journal_reader import read_journal_cached
from edgectl.state.lock import is_locked_elsewhere
from edgectl.usecases.fleet import Fleet

if TYPE_CHECKING:
    from edgectl.state.store import Store

# Above what the time of a reply varies by, below the time between two starts of one instance.
_START_TOLERANCE_S = 5.0


def record_snapshot(fleet: Fleet, snapshot: Snapshot) -> None:
    """Record the samples of a probe and the events that they show."""
    changing = is_locked_elsewhere(fleet.state)
    unfinished = read_journal_cached(fleet.state / JOURNAL_FILE_NAME).unfinished
    _record_and_prune(
        fleet, lambda store: store.record_snapshot(snapshot, changing=changing, unfinished=unfinished)
    )


def pin_task_starts(fleet: Fleet, snapshot: Snapshot) -> Snapshot:
    """``snapshot`` with the start of each run as it was first recorded.

    A start is measured as the time of the reply less an age on the host's clock, so it varies by the time
    that a reply takes. One that differs by more is another start. Of a run that has ended only the record
    knows it.
    """
    runs = [
        (name, host, task.instance)
        for host, each in snapshot.hosts.items()
        for name, task in each.tasks.items()
    ]
    known = fleet.history.use(fleet.state, fleet.warn, lambda store: store.task_starts(runs)) if runs else {}
    return replace(
        snapshot,
        hosts={
            host: replace(
                each,
                tasks={
                    name: replace(task, started_at=_pin_start(task, known.get((name, host, task.instance))))
                    for name, task in each.tasks.items()
                },
            )
            if each.tasks
            else each
            for host, each in snapshot.hosts.items()
        },
    )


def _pin_start(task: TaskSample, known: float | None) -> float:
    """Rounded, so that what the history keeps in milliseconds gives the same instant again."""
    same = known is not None and (not task.started_at or abs(known - task.started_at) < _START_TOLERANCE_S)
    return round(known if same and known is not None else task.started_at, 2)


def record_plan(fleet: Fleet, plan: Plan) -> None:
    """Record a plan that was made from a probe."""
    _record_and_prune(fleet, lambda store: store.record_plan(plan))


def record_results(fleet: Fleet, plan: Plan, results: Results) -> None:
    """Record the results of an apply. Call it before the lock is released, so that no later probe reports
    them as external events.
    """
    _record_and_prune(fleet, lambda store: store.record_results(plan, results, fleet.clock()))


def get_newest_event_id(fleet: Fleet) -> int:
    """The id of the newest recorded event, 0 where there is none."""
    return max((event.id for event in _read_events(fleet, lambda store: store.events(limit=1))), default=0)


def list_events_after(fleet: Fleet, after: int, *, limit: int = 200) -> tuple[Event, ...]:
    """The newest events with an id above ``after``, oldest first."""
    return _read_events(fleet, lambda store: store.events(after=after, limit=limit))


def _read_events(fleet: Fleet, look: "Callable[[Store], tuple[Event, ...]]") -> tuple[Event, ...]:
    return fleet.history.use(fleet.state, fleet.warn, look)


def _record_and_prune(fleet: Fleet, act: "Callable[[Store], None]") -> None:
    def record(store: "Store") -> None:
        act(store)
        if store.is_prune_due(fleet.clock()):
            store.prune(fleet.clock())

    with contextlib.ExitStack() as stack:
        if fleet.inventory.on_event:
            from edgectl.usecases.event_delivery import deliver_recorded_events

            stack.enter_context(deliver_recorded_events(fleet))
        fleet.history.use(fleet.state, fleet.warn, record)
