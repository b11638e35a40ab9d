# SPDX-License-Identifier: Apache-2.0
"""Metadata of dataclass fields for documents: keys, bounds, instants. The codec and the JSON Schemas read it.

A field needs none where the rules suffice: its key is its name, a number is finite and 0 or more, and a value
that equals its default is left out. A unit follows from the name (``used_bytes``).
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeVar

from edgectl.dataclass import dataclass

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Range of a number: at least ``minimum`` (None: any sign), or above it; at most ``maximum``."""

    minimum: float | None = 0.0
    above: bool = False
    maximum: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Rounded:
    """Precision in a document: so many ``decimals``, or significant ``digits``."""

    decimals: int | None = None
    digits: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Converted:
    """A value that ``convert`` replaces once it is decoded."""

    convert: Callable[[Any], Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class InstantFormat:
    """Seconds since 1970 that a document holds as RFC 3339 text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnFormat:
    """Dataclasses that a document holds as one list for each of their fields."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EachAlone:
    """A mapping or a tuple that is decoded entry by entry: one that does not fit is left out.

    Entries of type ``object`` may be null.
    """


Instant = Annotated[float, InstantFormat()]
Positive = Annotated[float, Bounds(above=True)]
Signed = Annotated[float, Bounds(minimum=None)]
Share = Annotated[float, Bounds(maximum=1.0)]
SignedInt = Annotated[int, Bounds(minimum=None)]
FromOne = Annotated[int, Bounds(minimum=1)]
Columns = Annotated[tuple[Item, ...], ColumnFormat()]


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentKey:
    """How one field stands in a document.

    ``key``: empty for the field's name; ``options.full`` is the key ``full`` of an object ``options``.
    ``always``: written even at its default. ``required``: the same, and an error where it is absent.
    ``needed_when``: required where another field, an enum, has this value. ``inline``: the keys of the
    dataclass stand beside the others. ``entries``: a mapping by tuples is a list of objects, with these keys
    for the parts of a tuple and, unless its values are dataclasses, ``value_key``. ``keyed_by``: a tuple of
    dataclasses is an object, keyed by that field. ``value_key`` alone: each value of a mapping is an object
    of this one key. ``by_resource``: a mapping by resource is an object for each resource, with these amounts
    in its unit (``cpu: {used_cores: 1}``); ``host_only`` leaves out those of links.
    """

    key: str = ""
    always: bool = False
    required: bool = False
    needed_when: tuple[str, Any] | None = None
    inline: bool = False
    entries: tuple[str, ...] = ()
    value_key: str = ""
    keyed_by: str = ""
    by_resource: tuple[str, ...] = ()
    host_only: bool = False


METADATA_KEY = "document"
PLAIN_KEY = DocumentKey()


def in_document(
    key: str = "",
    *,
    always: bool = False,
    required: bool = False,
    needed_when: tuple[str, Any] | None = None,
    inline: bool = False,
    entries: tuple[str, ...] = (),
    value_key: str = "",
    keyed_by: str = "",
    by_resource: tuple[str, ...] = (),
    host_only: bool = False,
) -> Mapping[str, Any]:
    """Metadata of a field as ``DocumentKey`` describes it: ``field(default=0,
    metadata=in_document(always=True))``.
    """
    return {
        METADATA_KEY: DocumentKey(
            key=key,
            always=always or required,
            required=required,
            needed_when=needed_when,
            inline=inline,
            entries=entries,
            value_key=value_key,
            keyed_by=keyed_by,
            by_resource=by_resource,
            host_only=host_only,
        )
    }
