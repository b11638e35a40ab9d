# SPDX-License-Identifier: Apache-2.0
"""Base classes of the outputs: each is one class, with a method for each form that it has."""

from collections.abc import Sequence
from typing import ClassVar

from edgectl.formats.document import Document
from edgectl.views import encoder
from edgectl.views.output_format import (
    ITEM_FORMATS,
    Formats,
    OutputFormat,
    check_output_format,
)
from edgectl.views.text import PLAIN, RenderOptions, escape_unprintable

# Of the documents that are printed; plans and snapshots, which are read back, have a version of their own.
OUTPUT_VERSION = 2


class View:
    """One thing that is shown. A class states its ``formats`` and overrides the methods that they need."""

    formats: ClassVar[Formats] = ITEM_FORMATS

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Text for people."""
        raise NotImplementedError

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with more columns, where there are any."""
        return self.table(look)

    def notes(self) -> Sequence[str]:
        """Remarks on the whole, which stand below the table, on stderr."""
        return ()

    def document(self) -> Document:
        """The whole as JSON types."""
        raise NotImplementedError

    def rows(self) -> Sequence[Document]:
        """The rows of JSON Lines and CSV."""
        raise NotImplementedError

    def names(self) -> Sequence[str]:
        """KIND/NAME of each thing, for other commands."""
        raise NotImplementedError

    def markdown(self) -> str:
        """A comment or a page."""
        raise NotImplementedError

    def gitlab(self) -> str:
        """A report of a GitLab job."""
        raise NotImplementedError


class EnvelopeView(View):
    """A document with an envelope: version, kind, and the remarks that tables have as notes."""

    kind: str

    def warnings(self) -> Sequence[str]:
        """Remarks on the whole; tables have them as notes."""
        return ()

    def notes(self) -> Sequence[str]:
        """The warnings; a class whose items carry a part of them adds that."""
        return self.warnings()

    def _build_envelope(self, key: str, content: object) -> Document:
        return {
            "format_version": OUTPUT_VERSION,
            "kind": self.kind,
            key: content,
            "warnings": list(self.warnings()),
        }


class ItemView(EnvelopeView):
    """One thing: ``{format_version, kind, item, warnings}``."""

    def item(self) -> Document:
        """The thing as JSON types."""
        raise NotImplementedError

    def document(self) -> Document:
        """The item in its envelope."""
        return self._build_envelope("item", round_item(self.item()))

    def rows(self) -> Sequence[Document]:
        """The item alone."""
        return [round_item(self.item())]


class ListView(EnvelopeView):
    """Things of one kind: ``{format_version, kind, items, warnings}``.

    An empty list has an empty table; its note says what there is none of.
    """

    def items(self) -> Sequence[Document]:
        """The things as JSON types."""
        raise NotImplementedError

    def document(self) -> Document:
        """The items in their envelope."""
        return self._build_envelope("items", list(self.rows()))

    def rows(self) -> Sequence[Document]:
        """The items alone."""
        return [round_item(item) for item in self.items()]


def round_item(item: Document) -> Document:
    """``item`` with its numbers rounded as all outputs have them."""
    return {key: encoder.round_numbers(value) for key, value in item.items()}


def render_view(view: View, form: OutputFormat, look: RenderOptions = PLAIN) -> str:
    """``view`` in ``form``.

    Raises:
        UsageError: it has no such form.
    """
    match check_output_format(form, view.formats):
        case OutputFormat.TABLE:
            return view.table(look)
        case OutputFormat.WIDE:
            return view.wide(look)
        case OutputFormat.JSON:
            return encoder.encode_json(view.document())
        case OutputFormat.JSONL:
            return encoder.encode_json_lines(view.rows())
        case OutputFormat.YAML:
            return encoder.encode_yaml(view.document())
        case OutputFormat.CSV:
            return encoder.encode_csv(view.rows())
        case OutputFormat.NAME:
            return "".join(f"{escape_unprintable(name)}\n" for name in dict.fromkeys(view.names()))
        case OutputFormat.GITLAB:
            return view.gitlab()
        case _:
            return view.markdown()
