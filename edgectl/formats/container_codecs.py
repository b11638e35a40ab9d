# SPDX-License-Identifier: Apache-2.0
"""Codecs of lists, sets, mappings and tables by resource, made from the codecs of their items."""

from collections.abc import Iterable, Iterator
from typing import Any

from edgectl.formats.document import Fault, Faults, FieldPath
from edgectl.formats.scalar_codecs import Codec, Schema, compile_plain, is_type, report_absent
from edgectl.model.resource import ResourceMap


def decode_each(codec: Codec, raw: list[Any], path: FieldPath, faults: Faults) -> list[Any]:
    """The values of a list, where null is a fault."""
    return [_decode_inner(codec, inner, (*path, index), faults) for index, inner in enumerate(raw)]


def _decode_inner(codec: Codec, raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
    """A value of a list or of an object, where null means absent."""
    if raw is None:
        faults.append(Fault(path=path, message="must not be null"))
        return None
    return codec.decode(raw, path, faults)


def compile_tuple(item: Codec, size: int | None) -> Codec:
    """A list; ``size``: its length, None for any."""

    def decode_list(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, list, path, faults):
            return None
        if size is not None and len(raw) != size:
            faults.append(Fault(path=path, message=f"must be a list of {size}, not of {len(raw)}"))
            return None
        return tuple(decode_each(item, raw, path, faults))

    limits = {} if size is None else {"minItems": size, "maxItems": size}
    return Codec(
        lambda values: [item.encode(value) for value in values],
        decode_list,
        lambda found: {"type": "array", "items": item.schema(found)} | limits,
    )


def compile_set(item: Codec) -> Codec:
    """A set as a sorted list."""

    def decode_set(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        return frozenset(decode_each(item, raw, path, faults)) if is_type(raw, list, path, faults) else None

    return Codec(
        lambda values: sorted(item.encode(value) for value in values),
        decode_set,
        lambda found: {"type": "array", "items": item.schema(found), "uniqueItems": True},
    )


def compile_mapping(key: Codec, item: Codec) -> Codec:
    """A mapping as an object; ``key`` is the codec of its keys."""

    def decode_mapping(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, dict, path, faults):
            return None
        return {
            key.decode(name, path, faults): _decode_inner(item, inner, (*path, name), faults)
            for name, inner in raw.items()
        }

    return Codec(
        lambda values: {key.encode(name): item.encode(value) for name, value in values.items()},
        decode_mapping,
        lambda found: {"type": "object", "additionalProperties": item.schema(found)},
    )


def _decode_alone(
    codec: Codec, pairs: Iterable[tuple[Any, Any]], path: FieldPath
) -> Iterator[tuple[Any, Any]]:
    """(place, value) of each entry without faults."""
    for place, inner in pairs:
        faults: Faults = []
        value = codec.decode(inner, (*path, place), faults)
        if not faults:
            yield place, value


def compile_mapping_alone(key: Codec, item: Codec) -> Codec:
    """As ``compile_mapping``; an entry that does not fit is left out."""

    def decode_mapping(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, dict, path, faults):
            return None
        return {
            key.decode(name, path, faults): value for name, value in _decode_alone(item, raw.items(), path)
        }

    def decode_changed(raw: Any, before: Any, known: Any) -> Any:  # noqa: ANN401
        """The entries that are not the very same objects as before are decoded, if all of them fit."""
        if not (isinstance(raw, dict) and isinstance(before, dict)):
            return None
        changed = {name: inner for name, inner in raw.items() if inner is not before.get(name)}
        fresh = decode_mapping(changed, (), [])
        if fresh.keys() != changed.keys() or not raw.keys() - changed.keys() <= known.keys():
            return None
        return {name: fresh[name] if name in changed else known[name] for name in raw}

    return compile_mapping(key, item)._replace(decode=decode_mapping, again=decode_changed)


def compile_tuple_alone(item: Codec) -> Codec:
    """As ``compile_tuple``; an item that does not fit is left out."""

    def decode_list(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, list, path, faults):
            return None
        return tuple(value for _, value in _decode_alone(item, enumerate(raw), path))

    return compile_tuple(item, None)._replace(decode=decode_list)


def compile_resource_map(kind: type[ResourceMap[Any]], item: Codec) -> Codec:
    """Values by the names of a table.

    One that is absent has its default where that is 0 or null, or where documents leave it out; else it must
    be there. Where values may be null, a null in place of one that is left out counts.
    """
    nullable = None in kind.DEFAULTS.values()

    def decode_map(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, dict, path, faults):
            return None
        values = {}
        for name, default in kind.DEFAULTS.items():
            if raw.get(name) is not None:
                values[name] = item.decode(raw[name], (*path, name), faults)
            elif nullable and name in raw:
                values[name] = None
            elif default and name not in kind.OMITTED:
                report_absent(name, raw, path, faults)
        return kind(values)

    def describe(found: Schema) -> Schema:
        needed = [name for name, default in kind.DEFAULTS.items() if default and name not in kind.OMITTED]
        properties = {name: item.schema(found) for name in kind.DEFAULTS}
        return {"type": "object", "properties": properties} | ({"required": needed} if needed else {})

    def encode_map(values: ResourceMap[Any]) -> dict[str, Any]:
        return {
            name: item.encode(value)
            for name, value in values.items()
            if name not in kind.OMITTED or value != kind.DEFAULTS[name]
        }

    return Codec(encode_map, decode_map, describe)


def compile_wrapped(item: Codec, key: str) -> Codec:
    """A value in an object of one key."""

    def decode_wrapped(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, dict, path, faults):
            return None
        if raw.get(key) is None:
            return report_absent(key, raw, path, faults)
        return item.decode(raw[key], (*path, key), faults)

    return Codec(
        lambda value: {key: item.encode(value)},
        decode_wrapped,
        lambda found: {"type": "object", "properties": {key: item.schema(found)}, "required": [key]},
    )


def compile_entries(item: Codec, parts: tuple[str, ...], value_key: str) -> Codec:
    """A mapping by tuples as a list of objects."""
    inner = compile_wrapped(item, value_key) if value_key else item
    names = [compile_wrapped(compile_plain(str), part) for part in parts]

    def decode_entries(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, list, path, faults):
            return None
        decoded: dict[Any, Any] = {}
        for index, entry in enumerate(raw):
            place = (*path, index)
            if is_type(entry, dict, place, faults):
                key = tuple(name.decode(entry, place, faults) for name in names)
                decoded[key] = inner.decode(entry, place, faults)
        return decoded

    def describe(found: Schema) -> Schema:
        keys = {
            "type": "object",
            "properties": {part: {"type": "string"} for part in parts},
            "required": list(parts),
        }
        return {"type": "array", "items": {"allOf": [keys, inner.schema(found)]}}

    return Codec(
        lambda values: [
            dict(zip(parts, key, strict=True)) | inner.encode(values[key]) for key in sorted(values)
        ],
        decode_entries,
        describe,
    )
