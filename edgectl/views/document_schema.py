# SPDX-License-Identifier: Apache-2.0
"""JSON Schemas of the documents that ``-o json`` prints, from the glossary and the keys of each kind."""

from collections.abc import Iterable, Iterator
from typing import Any

from edgectl.views.document_keys import (
    ESTIMATE_MAPS,
    INNER_KEYS,
    ITEM_KEYS,
    LIST_KEYS,
    LISTED_KEYS,
    NUMBER_LIST_MAPS,
    NUMBER_MAPS,
)
from edgectl.views.glossary import KeyEntry, KeyType, list_keys
from edgectl.views.output import OUTPUT_VERSION

Schema = dict[str, Any]
DOCUMENT_KINDS = tuple(sorted(LIST_KEYS.keys() | ITEM_KEYS.keys()))

_NUMBER: Schema = {"type": ["number", "null"]}
_TEXT: Schema = {"type": ["string", "null"]}
_SCALARS: dict[KeyType, Schema] = {
    KeyType.TEXT: _TEXT,
    KeyType.NUMBER: _NUMBER,
    KeyType.FLAG: {"type": ["boolean", "null"]},
    KeyType.INSTANT: {**_TEXT, "format": "date-time"},
    KeyType.OPAQUE: {},
}


def build_view_schema(kind: str) -> Schema:
    """The schema of the documents of one of ``DOCUMENT_KINDS``; some kinds have a list and a single item."""
    forms: Schema = {}
    if kind in LIST_KEYS:
        forms["items"] = {"type": "array", "items": _describe_object(LIST_KEYS[kind])}
    if kind in ITEM_KEYS:
        forms["item"] = _describe_object(ITEM_KEYS[kind])
    roots = (*LIST_KEYS.get(kind, ()), *ITEM_KEYS.get(kind, ()))
    entries = {entry.key: entry for entry in list_keys()}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": kind,
        "description": f"edgectl: {kind}. Written by edgectl schema.",
        "type": "object",
        "properties": {
            "format_version": {"const": OUTPUT_VERSION},
            "kind": {"const": kind},
            **forms,
            "warnings": {"type": "array", "items": {"type": "string"}},
        },
        "required": ["format_version", "kind", "warnings"],
        "oneOf": [{"required": [form]} for form in forms],
        "$defs": {key: _describe_key(entries[key]) for key in sorted(_collect_keys(roots, set()))},
    }


def _collect_keys(keys: Iterable[str], found: set[str]) -> set[str]:
    """The keys, and those of the objects inside."""
    for key in keys:
        if key not in found:
            found.add(key)
            _collect_keys(_list_inner_keys(key), found)
    return found


def _list_inner_keys(key: str) -> Iterator[str]:
    for table in (INNER_KEYS, LISTED_KEYS, ESTIMATE_MAPS):
        yield from table.get(key, ())


def _describe_key(entry: KeyEntry) -> Schema:
    """The schema of the values of a key, with its meaning and its unit."""
    unit = f" ({entry.unit})" if entry.unit else ""
    return {"description": entry.meaning + unit, **_describe_value(entry)}


def _describe_value(entry: KeyEntry) -> Schema:
    match entry.type:
        case KeyType.OBJECT:
            return _describe_object(INNER_KEYS[entry.key]) | {"type": ["object", "null"]}
        case KeyType.LIST:
            keys = INNER_KEYS.get(entry.key)
            items = {"type": "string"} if keys is None else _describe_object(keys)
            return {"type": ["array", "null"], "items": items}
        case KeyType.MAP:
            return {"type": ["object", "null"], "additionalProperties": _describe_map_value(entry.key)}
        case _:
            return dict(_SCALARS[entry.type])


def _describe_map_value(key: str) -> Schema:
    if key in ESTIMATE_MAPS:
        return {"anyOf": [_NUMBER, _describe_object(ESTIMATE_MAPS[key])]}
    if key in INNER_KEYS:
        return _describe_object(INNER_KEYS[key])
    if key in LISTED_KEYS:
        estimate = {"anyOf": [_describe_object(LISTED_KEYS[key]), {"type": "null"}]}
        return {"type": "array", "items": estimate}
    if key in NUMBER_LIST_MAPS:
        return {"type": "array", "items": _NUMBER}
    return _NUMBER if key in NUMBER_MAPS else _TEXT


def _describe_object(keys: Iterable[str]) -> Schema:
    return {"type": "object", "properties": {key: {"$ref": f"#/$defs/{key}"} for key in keys}}
