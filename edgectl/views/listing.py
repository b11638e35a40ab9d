# SPDX-License-Identifier: Apache-2.0
"""Listings of edges, robots, tasks and links, and the changes from one probe to the next.

Measurements (usage, round trips, ages) stand in ``-o wide`` and in the documents, and are no change:
``edgectl top`` shows them.
"""

from collections.abc import Mapping, Sequence

from edgectl.formats.document import Document
from edgectl.model.resource import HOST_RESOURCES
from edgectl.units import format_instant
from edgectl.views.glossary import head
from edgectl.views.listing_items import Change, ItemChange, Listing, ListingItem, ListingKind
from edgectl.views.output import ListView, round_item
from edgectl.views.output_format import FLEET_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, measure_column_widths, render_columns

# Of each kind: the columns, those that wide adds before the last one, and the headings of numbers.
_CAPACITY_COLUMNS = tuple(f"{resource.name}.capacity_{resource.unit.name}" for resource in HOST_RESOURCES)
_SHARE_COLUMNS = tuple(f"{resource.name}.share" for resource in HOST_RESOURCES)
_HOST_COLUMNS = ("host", "status", *_CAPACITY_COLUMNS, "task_count")
_WIDE_HOST_COLUMNS = ("address", *_SHARE_COLUMNS)
_COLUMNS: Mapping[ListingKind, tuple[tuple[str, ...], tuple[str, ...]]] = {
    ListingKind.HOSTS: ((*_HOST_COLUMNS, "role", "labels"), _WIDE_HOST_COLUMNS),
    ListingKind.EDGES: ((*_HOST_COLUMNS, "labels"), _WIDE_HOST_COLUMNS),
    ListingKind.ROBOTS: ((*_HOST_COLUMNS, "onboard", "labels"), _WIDE_HOST_COLUMNS),
    ListingKind.TASKS: (
        ("task", "host", "state", "restarts", "age_s"),
        ("kind", "robots", "needs", "pid", "metrics"),
    ),
    ListingKind.LINKS: (
        ("edge", "robot", "capacity_bytes_per_s", "capacity_source", "capacity_age_s"),
        ("nominal_bytes_per_s", "network.used_bytes_per_s", "rtt_ms"),
    ),
}
_NUMBERS = {
    *_CAPACITY_COLUMNS, *_SHARE_COLUMNS, "task_count", "restarts",
    "age_s", "pid", "capacity_bytes_per_s", "capacity_age_s", "nominal_bytes_per_s",
    "network.used_bytes_per_s", "rtt_ms",
}  # fmt: skip
_WRAPPED_COLUMNS = frozenset(range(12))


class ListingView(ListView):
    """A listing below its headings, then the hosts that do not answer."""

    formats = FLEET_FORMATS

    def __init__(self, listing: Listing, *, headers: bool = True) -> None:
        self._listing, self._headers = listing, headers
        self.kind = listing.kind.value.removesuffix("s")

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per item."""
        return _render_listing(self._listing, look, wide=False, headers=self._headers)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with measurements and more declarations."""
        return _render_listing(self._listing, look, wide=True, headers=self._headers)

    def items(self) -> Sequence[Document]:
        """The items as JSON types."""
        return [item.document for item in self._listing.items]

    def warnings(self) -> Sequence[str]:
        """Hosts without a reply, and tasks that run twice or at lost places."""
        return self._listing.notes

    def notes(self) -> Sequence[str]:
        """The same, and that nothing is listed."""
        return _list_listing_notes(self._listing)

    def names(self) -> Sequence[str]:
        """KIND/NAME of each item."""
        return [item.name for item in self._listing.items]


class AllListingsView(ListView):
    """Listings of several kinds, each below its own headings; documents name the kind of each item."""

    kind = "all"
    formats = FLEET_FORMATS

    def __init__(self, listings: Sequence[Listing], *, headers: bool = True) -> None:
        self._listings, self._headers = listings, headers

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One table after the other."""
        return self._render(look, wide=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The same with measurements and more declarations."""
        return self._render(look, wide=True)

    def _render(self, look: RenderOptions, *, wide: bool) -> str:
        parts = (_render_listing(each, look, wide=wide, headers=self._headers) for each in self._listings)
        return "\n".join(part for part in parts if part)

    def items(self) -> Sequence[Document]:
        """The items as JSON types, with the kind of each."""
        return [
            {"kind": item.name.partition("/")[0], **item.document}
            for each in self._listings
            for item in each.items
        ]

    def warnings(self) -> Sequence[str]:
        """The notes of all listings, each once."""
        return list(dict.fromkeys(note for each in self._listings for note in each.notes))

    def names(self) -> Sequence[str]:
        """KIND/NAME of each item."""
        return [item.name for each in self._listings for item in each.items]


class ListingChangesView(ListView):
    """The changes of a listing, below the lines of the ``first`` one; where this is the first, all of it."""

    formats = FLEET_FORMATS
    kind = "change"

    def __init__(self, listing: Listing, changes: Sequence[Change], first: Listing | None) -> None:
        self._listing, self._changes, self._first = listing, changes, first

    def table(self, look: RenderOptions = PLAIN) -> str:
        """The lines that changed."""
        return self._render(look, wide=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The same in full."""
        return self._render(look, wide=True)

    def _render(self, look: RenderOptions, *, wide: bool) -> str:
        if self._first is None:
            return _render_listing(self._listing, look, wide=wide)
        rows = [
            _build_deleted_item_row(item, wide=wide)
            if change is ItemChange.DELETED
            else _build_item_row(item, wide=wide)
            for change, item in self._changes
        ]
        return render_columns(
            rows,
            look,
            right=_find_number_columns(self._first.kind, wide=wide),
            wrap=_WRAPPED_COLUMNS,
            least=measure_column_widths(_build_listing_rows(self._first, wide=wide)),
        )

    def items(self) -> Sequence[Document]:
        """The changes: type, instant and the item as it is now."""
        at = format_instant(self._listing.at)
        return [
            {"type": change.value, "at": at, "object": round_item(item.document)}
            for change, item in self._changes
        ]

    def notes(self) -> Sequence[str]:
        """The notes of the first listing."""
        return _list_listing_notes(self._listing) if self._first is None else ()

    def names(self) -> Sequence[str]:
        """KIND/NAME of each item that changed."""
        return [item.name for _, item in self._changes]


def _list_listing_notes(value: Listing) -> list[str]:
    return [*([] if value.items else [f"no {value.kind}"]), *value.notes]


def _render_listing(value: Listing, look: RenderOptions, *, wide: bool, headers: bool = True) -> str:
    return (
        render_columns(
            _build_listing_rows(value, wide=wide)[0 if headers else 1 :],
            look,
            right=_find_number_columns(value.kind, wide=wide),
            wrap=_WRAPPED_COLUMNS,
        )
        if value.items
        else ""
    )


def _build_listing_rows(value: Listing, *, wide: bool) -> list[Row]:
    return [
        head(*_list_columns(value.kind, wide=wide)),
        *(_build_item_row(item, wide=wide) for item in value.items),
    ]


def _list_columns(kind: ListingKind, *, wide: bool) -> tuple[str, ...]:
    columns, more = _COLUMNS[kind]
    return (*columns[:-1], *more, columns[-1]) if wide else columns


def _find_number_columns(kind: ListingKind, *, wide: bool) -> frozenset[int]:
    columns = _list_columns(kind, wide=wide)
    return frozenset(place for place, column in enumerate(columns) if column in _NUMBERS)


def _build_item_row(item: ListingItem, *, wide: bool) -> Row:
    return (*item.row[:-1], *item.wide_cells, item.row[-1]) if wide else item.row


def _build_deleted_item_row(item: ListingItem, *, wide: bool) -> Row:
    """Only tasks that no file names can go."""
    name, host, _, *rest = _build_item_row(item, wide=wide)
    return (name, host, Cell("gone", "bad"), *rest)
