"""events: what happened to the fleet, from the history alone. No host is asked."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from edgectl.model.event import Event
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.record import get_newest_event_id


@dataclass(frozen=True, slots=True, kw_only=True)
class EventFilter:
    """Which events: not older than ``since`` (s since 1970), of one host, of one task."""

    since: float | None = None
    host: str | None = None
    task: str | None = None


def list_events(fleet: Fleet, wanted: EventFilter, *, after: int = 0) -> tuple[Event, ...]:
    """Those with an id above ``after``, oldest first; none where nothing was recorded."""
    return fleet.history.use(
        fleet.state,
        fleet.warn,
        lambda store: store.events(after=after, since=wanted.since, host=wanted.host, task=wanted.task),
    )


def follow_events(
    fleet: Fleet, wanted: EventFilter, told_to_end: Callable[[], bool]
) -> Iterator[tuple[Event, ...]]:
    """Those that are there (perhaps none), then batches as they come. ``told_to_end`` is asked between two looks, and may wait."""
    last = get_newest_event_id(fleet)
    yield tuple(event for event in list_events(fleet, wanted) if event.id <= last)
    while not told_to_end():
        newest = get_newest_event_id(fleet)
        if newest < last:
            # Another history began, whose numbers begin anew: the one before was broken, or taken away.
            last = 0
        found = list_events(fleet, wanted, after=last) if newest > last else ()
        if found:
            yield found
        last = max([newest, *(event.id for event in found)])
