# SPDX-License-Identifier: Apache-2.0
"""Parts of a description: fields, sections and the last events; and several descriptions."""

import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from edgectl.formats.document import Document
from edgectl.model.event import Event
from edgectl.views.events import render_events
from edgectl.views.output import ItemView, ListView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns, style_text

Field = tuple[str, str | Cell]
_INDENT = 2
# Two empty lines, as between the descriptions of kubectl.
_SEPARATOR = "\n\n"


class DetailsView(ListView):
    """Hosts and tasks one after the other; documents name the kind of each item."""

    kind = "details"
    formats = ITEM_FORMATS

    def __init__(self, views: Sequence[ItemView]) -> None:
        self._views = views

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Each as alone, with two empty lines between."""
        return _SEPARATOR.join(view.table(look) for view in self._views)

    def items(self) -> Sequence[Document]:
        """The item of each, with its kind."""
        return [{"kind": view.kind, **view.item()} for view in self._views]

    def warnings(self) -> Sequence[str]:
        """The warnings of all, each once."""
        return list(dict.fromkeys(text for view in self._views for text in view.warnings()))


def render_fields(found: Iterable[Field], look: RenderOptions) -> str:
    """A line per field that is not empty."""
    return render_columns([(Cell(f"{name}:", "bold"), text) for name, text in found if text], look)


def render_section(
    title: str, rows: Sequence[Row], look: RenderOptions, *, right: Collection[int] = ()
) -> str:
    """Indented rows below a title, where there are any. ``right``: columns aligned to the right."""
    if not rows:
        return ""
    narrow = look if look.width is None else replace(look, width=max(1, look.width - _INDENT))
    return (
        style_text(f"{title}:", "bold", look)
        + "\n"
        + textwrap.indent(render_columns(rows, narrow, right=right, wrap=set(range(8))), " " * _INDENT)
    )


def render_events_section(values: Sequence[Event] | None, look: RenderOptions) -> str:
    """The last events; nothing where none were asked for."""
    if values is None:
        return ""
    if not values:
        return style_text("Events:", "bold", look) + " none\n"
    narrow = look if look.width is None else replace(look, width=max(1, look.width - _INDENT))
    return (
        style_text("Events:", "bold", look)
        + "\n"
        + textwrap.indent(render_events(values, narrow), " " * _INDENT)
    )


def format_pairs(values: Mapping[str, str]) -> str:
    """Names and values; a secret shows as its mask."""
    return ", ".join(f"{name}={text}" for name, text in values.items())
