# SPDX-License-Identifier: Apache-2.0
"""The meaning of a key of a file, of a code, or of a check."""

from collections.abc import Sequence
from typing import Protocol

from edgectl.formats.document import Document
from edgectl.views.output import ItemView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns, style_text, wrap_text


class ReferenceText(Protocol):
    """An entry of the reference."""

    @property
    def name(self) -> str:
        """Path of a key, or a code."""

    @property
    def values(self) -> str:
        """What may be written."""

    @property
    def default(self) -> str:
        """What counts where nothing is written."""

    @property
    def meaning(self) -> str:
        """What it does."""

    @property
    def keys(self) -> "Sequence[ReferenceText]":
        """The keys below it."""


class ReferenceView(ItemView):
    """One entry with the keys below it."""

    kind = "reference"
    formats = ITEM_FORMATS

    def __init__(self, entry: ReferenceText) -> None:
        self._entry = entry

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The meaning, what may be written, and the keys."""
        entry = self._entry
        text = style_text(entry.name, "bold", look) + "\n" + wrap_text(entry.meaning, look, indent=0)
        facts: list[Row] = [("Values:", entry.values), ("Default:", entry.default)]
        text += render_columns([fact for fact in facts if fact[1]], look, wrap={1})
        rows: list[Row] = [(Cell(each.name.rpartition(".")[2], "name"), each.meaning) for each in entry.keys]
        return text + ("\nKeys:\n" + render_columns(rows, look, wrap={1}) if rows else "")

    def item(self) -> Document:
        """The entry as JSON types."""
        entry = self._entry
        return {
            "name": entry.name,
            "meaning": entry.meaning,
            "allowed": entry.values or None,
            "default": entry.default or None,
            "keys": [each.name for each in entry.keys],
        }
