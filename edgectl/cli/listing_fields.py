# SPDX-License-Identifier: Apache-2.0
"""One key of the items of a listing: to sort by, or to print alone."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from edgectl.errors import UsageError
from edgectl.names import check_known_names, natural_key

if TYPE_CHECKING:
    from edgectl.formats.document import Document
    from edgectl.views.listing_items import Listing

_MISSING = object()


def sort_listing(listing: "Listing", path: str | None) -> "Listing":
    """``listing`` with its items in the order of the key ``path``; those without it come last.

    Raises:
        UsageError: no item has this key, or it holds no single value.
    """
    if path is None:
        return listing
    items = [item.document for item in listing.items]
    order = rank_documents(items, path, listing.kind.removesuffix("s"))
    return replace(listing, items=tuple(listing.items[place] for place in order))


def rank_documents(items: "Sequence[Document]", path: str, kind: str) -> list[int]:
    """The places of the documents of ``kind`` in the order of the key ``path``; those without it come last.

    Raises:
        UsageError: no item has this key, or it holds no single value.
    """
    _check_path(items, path, kind)
    return sorted(range(len(items)), key=lambda place: _rank(_find(items[place], path), path))


def list_field(items: "Sequence[Document]", path: str, kind: str) -> list[str]:
    """The value of the key ``path`` of each document of ``kind``, as text; objects and lists as JSON, nothing
    as ``-``.

    Raises:
        UsageError: no item has this key.
    """
    _check_path(items, path, kind)
    return [_format(_find(item, path)) for item in items]


def _check_path(items: "Sequence[Document]", path: str, kind: str) -> None:
    from edgectl.views.document_keys import LIST_KEYS

    stated = LIST_KEYS[kind]
    found = {key for item in items for key in _list_paths(item)}
    check_known_names([path], sorted({*stated, *found}), "key of -o json", every=True)


def _list_paths(value: object, start: str = "") -> Iterable[str]:
    for key, inner in value.items() if isinstance(value, Mapping) else ():
        yield start + str(key)
        yield from _list_paths(inner, f"{start}{key}.")


def _find(value: object, path: str) -> object:
    """The value at ``path``; a name with dots is one key where it is one."""
    if not isinstance(value, Mapping):
        return _MISSING
    if path in value:
        return value[path]
    keys = path.split(".")
    for end in range(1, len(keys)):
        if (key := ".".join(keys[:end])) in value:
            return _find(value[key], ".".join(keys[end:]))
    return _MISSING


def _rank(value: object, path: str) -> tuple[object, ...]:
    if value is _MISSING or value is None:
        return (2,)
    if isinstance(value, str):
        return (1, natural_key(value))
    if isinstance(value, int | float):
        return (0, value)
    raise UsageError(f"cannot sort by {path}, which is no single value", hint="show its keys: -o json")


def _format(value: object) -> str:
    if value is _MISSING or value is None:
        return "-"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
