"""Events as JSON types, for documents and for what ``on_event`` starts."""

from edgectl.formats.document import Document
from edgectl.model.event import Event
from edgectl.units import format_instant


def encode_event(value: Event) -> Document:
    """One event as JSON types; its ``id`` grows from event to event."""
    return {
        "id": value.id,
        "at": format_instant(value.at),
        "kind": value.kind.value,
        "host": value.host,
        "task": value.task,
        "message": value.message,
    }
