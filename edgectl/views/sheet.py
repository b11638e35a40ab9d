"""The parts of which a description is made: fields, sections and what happened last."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from edgectl.model.event import Event
from edgectl.views import events as events_view
from edgectl.views.text import Cell, Look, Row, columns, paint

Field = tuple[str, str | Cell]
_INDENT = 2


def fields(found: Iterable[Field], look: Look) -> str:
    """A line per field that says something."""
    return columns([(Cell(f"{name}:", "bold"), text) for name, text in found if text], look)


def section(title: str, rows: Sequence[Row], look: Look) -> str:
    """Indented rows below a title, where there are any."""
    if not rows:
        return ""
    narrow = look if look.width is None else replace(look, width=max(1, look.width - _INDENT))
    return paint(f"{title}:", "bold", look) + "\n" + textwrap.indent(columns(rows, narrow, wrap=set(range(8))), " " * _INDENT)


def events_section(values: Sequence[Event] | None, look: Look) -> str:
    """The last events; nothing where nobody looked for any."""
    if values is None:
        return ""
    if not values:
        return paint("Events:", "bold", look) + " none\n"
    narrow = look if look.width is None else replace(look, width=max(1, look.width - _INDENT))
    return paint("Events:", "bold", look) + "\n" + textwrap.indent(events_view.text(values, narrow), " " * _INDENT)


def pairs(values: Mapping[str, str]) -> str:
    """Names and values; a secret shows as its mask."""
    return ", ".join(f"{name}={text}" for name, text in values.items())
