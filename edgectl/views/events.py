"""Events of a fleet."""

from collections.abc import Iterable, Mapping, Sequence

from edgectl.formats.document import Document
from edgectl.formats.event_document import encode_event
from edgectl.model.assignment import Reason
from edgectl.model.event import Event, EventKind
from edgectl.units import format_instant
from edgectl.views.glossary import head
from edgectl.views.output import ListView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns

_EVENT_STYLES = {
    EventKind.HOST_LOST: "bad",
    EventKind.HOST_BACK: "good",
    EventKind.HOST_REBOOTED: "warn",
    EventKind.ROAMED: "warn",
    EventKind.LINK_DOWN: "bad",
    EventKind.LINK_BACK: "good",
    EventKind.TASK_STARTED: "good",
    EventKind.TASK_READY: "good",
    EventKind.TASK_COMPLETED: "good",
    EventKind.TASK_RESTARTED: "warn",
    EventKind.TASK_ADOPTED: "warn",
    EventKind.TASK_FAILED: "bad",
    EventKind.TASK_CRASHLOOP: "bad",
    EventKind.TASK_UNHEALTHY: "bad",
    EventKind.TASK_LOST: "bad",
    EventKind.NODES_REMOVED: "good",
    EventKind.TASK_DEFERRED: "warn",
    EventKind.TASK_UNPLACED: "warn",
    EventKind.TASK_OVERUSE: "warn",
    EventKind.ACTION_FAILED: "bad",
    EventKind.PLANNED: "dim",
}
# Documents carry the code; tables what it means.
_UNPLACED_TEXTS: Mapping[str, str] = {
    Reason.NO_CANDIDATE: "no host may run it now",
    Reason.NO_FEASIBLE_HOST: "no host has room for it",
    Reason.PREDECESSOR_MISSING: "a task that it needs is not placed",
    Reason.GROUP: "a task of its group has no place",
    Reason.PREDECESSOR_INCOMPLETE: "a task that it needs has not completed",
}
_EVENT_HEAD = head("at", "kind", "subject", "message")
_NO_EVENTS = "no events in this time, or no edgectl observed any (edgectl probe does)"
# Minimum widths of rows that come one by one: an instant, the longest kind, most names.
EVENT_COLUMN_WIDTHS = (20, max(len(kind) for kind in EventKind), 24)


class EventsView(ListView):
    """Events, oldest first. ``stream``: part of a table that continues; ``first``: the part with headings."""

    kind = "event"
    formats = ITEM_FORMATS

    def __init__(self, events: Iterable[Event], *, stream: bool = False, first: bool = True) -> None:
        self._events, self._stream, self._first = list(events), stream, first

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per event."""
        if not self._stream:
            return render_events(self._events, look)
        rows = [*([_EVENT_HEAD] if self._first else []), *map(_render_event_row, self._events)]
        return render_columns(rows, look, wrap={2}, least=EVENT_COLUMN_WIDTHS)

    def notes(self) -> Sequence[str]:
        """That there are none."""
        return [] if self._events or self._stream else [_NO_EVENTS]

    def items(self) -> Sequence[Document]:
        """The events as JSON types."""
        return [encode_event(value) for value in self._events]


def render_events(values: Iterable[Event], look: RenderOptions = PLAIN) -> str:
    """One line per event below the headings."""
    rows = [_render_event_row(value) for value in values]
    return render_columns([_EVENT_HEAD, *rows], look, wrap={2}) if rows else ""


def _render_event_row(value: Event) -> Row:
    at = format_instant(float(int(value.at)))
    return (
        at,
        Cell(value.kind.value, _EVENT_STYLES.get(value.kind, "")),
        Cell(_format_event_subject(value), "name"),
        _UNPLACED_TEXTS.get(value.message, value.message) or "-",
    )


def _format_event_subject(value: Event) -> str:
    """The task and the host that the event concerns."""
    return " on ".join(name for name in (value.task, value.host) if name) or "-"
