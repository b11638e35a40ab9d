"""What happened to the fleet: a table for people, an object per event for programs."""

from collections.abc import Iterable, Mapping, Sequence

from edgectl.formats.document import FORMAT_VERSION, Document
from edgectl.model.assignment import Reason
from edgectl.model.event import Event, EventKind
from edgectl.units import format_instant
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns

_EVENT_STYLES = {
    EventKind.HOST_LOST: "bad", EventKind.HOST_BACK: "good", EventKind.HOST_REBOOTED: "warn", EventKind.TASK_STARTED: "good",
    EventKind.TASK_READY: "good", EventKind.TASK_COMPLETED: "good", EventKind.TASK_RESTARTED: "warn", EventKind.TASK_FAILED: "bad",
    EventKind.TASK_CRASHLOOP: "bad", EventKind.TASK_LOST: "bad", EventKind.TASK_DEFERRED: "warn", EventKind.TASK_UNPLACED: "warn",
    EventKind.ACTION_FAILED: "bad", EventKind.PLANNED: "dim",
}  # fmt: skip
# Programs are told the word; a person what it means.
_UNPLACED_TEXTS: Mapping[str, str] = {
    Reason.NO_CANDIDATE: "no host may run it now",
    Reason.NO_FEASIBLE_HOST: "no host has room for it",
    Reason.PREDECESSOR_MISSING: "a task that it needs has no place",
    Reason.PREDECESSOR_INCOMPLETE: "a task that it needs has not completed",
}
_EVENT_HEAD: Row = ("AT", "KIND", "WHAT", "MESSAGE")
_NO_EVENTS = "No events: nothing happened in this time, or no edgectl looked (edgectl probe does).\n"
# Widths that rows which come one by one keep, so that they stand below each other: an instant, the longest kind, most names.
EVENT_COLUMN_WIDTHS = (20, max(len(kind) for kind in EventKind), 24)


def render_events(values: Iterable[Event], look: RenderOptions = PLAIN) -> str:
    """One line per event, oldest first, below a head."""
    rows = [_render_event_row(value) for value in values]
    return render_columns([_EVENT_HEAD, *rows], look, wrap={2}) if rows else _NO_EVENTS


def render_more_events(values: Iterable[Event], head: object, look: RenderOptions = PLAIN) -> str:
    """Rows to go below others; ``head``: they are the first."""
    return render_columns(
        [*([_EVENT_HEAD] if head else []), *(_render_event_row(value) for value in values)],
        look,
        wrap={2},
        least=EVENT_COLUMN_WIDTHS,
    )


def _render_event_row(value: Event) -> Row:
    at = format_instant(float(int(value.at)))
    return (
        at,
        Cell(value.kind.value, _EVENT_STYLES.get(value.kind, "")),
        Cell(_format_event_subject(value), "name"),
        _UNPLACED_TEXTS.get(value.message, value.message) or "-",
    )


def _format_event_subject(value: Event) -> str:
    """Which task on which host, as far as it concerns one."""
    return " on ".join(name for name in (value.task, value.host) if name) or "-"


def encode_events(values: Sequence[Event]) -> Document:
    """All of them, as JSON types."""
    return {"format_version": FORMAT_VERSION, "events": [encode_event(value) for value in values]}


def encode_event(value: Event) -> Document:
    """One of them, as JSON types; its ``id`` grows from event to event."""
    return {
        "id": value.id, "at": format_instant(value.at), "kind": value.kind.value,
        "host": value.host, "task": value.task, "message": value.message,
    }  # fmt: skip
