# SPDX-License-Identifier: Apache-2.0
"""Events from the history; no host is asked."""

from collections.abc import Callable, Iterator

from edgectl.dataclass import dataclass
from edgectl.model.event import Event
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.record import get_newest_event_id


@dataclass(frozen=True, slots=True, kw_only=True)
class EventFilter:
    """Filter of events: not older than ``since`` (s since 1970), of one host, of ``tasks`` (none: of all)."""

    since: float | None = None
    host: str | None = None
    tasks: tuple[str, ...] = ()


def list_events(fleet: Fleet, wanted: EventFilter, *, after: int = 0) -> tuple[Event, ...]:
    """Events with an id above ``after``, oldest first; empty where nothing was recorded."""
    only = wanted.tasks[0] if len(wanted.tasks) == 1 else None
    found = fleet.history.use(
        fleet.state,
        fleet.warn,
        lambda store: store.events(after=after, since=wanted.since, host=wanted.host, task=only),
    )
    return tuple(event for event in found if not wanted.tasks or event.task in wanted.tasks)


def follow_events(
    fleet: Fleet, wanted: EventFilter, should_stop: Callable[[], bool]
) -> Iterator[tuple[Event, ...]]:
    """The recorded events (perhaps none), then batches as they come. ``should_stop`` is called between two
    reads and may wait.
    """
    last = get_newest_event_id(fleet)
    yield tuple(event for event in list_events(fleet, wanted) if event.id <= last)
    while not should_stop():
        newest = get_newest_event_id(fleet)
        if newest < last:
            # The history was replaced (broken or deleted): its ids start again.
            last = 0
        found = list_events(fleet, wanted, after=last) if newest > last else ()
        if found:
            yield found
        last = max([newest, *(event.id for event in found)])
