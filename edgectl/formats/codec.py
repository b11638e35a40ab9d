# SPDX-License-Identifier: Apache-2.0
"""Dataclasses to JSON and back by their types and ``edgectl.model.encoding``: every fault at once, each with
its path.

``compile_type`` turns a type into a ``Codec`` once; a dataclass is an object, a mapping an object, a tuple a
list. Keys that a class does not have are ignored. A value that is wrong is a fault and decodes to None, so
that decoding goes on.
"""

import types
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

from edgectl.formats.container_codecs import (
    compile_entries,
    compile_mapping,
    compile_mapping_alone,
    compile_resource_map,
    compile_set,
    compile_tuple,
    compile_tuple_alone,
    compile_wrapped,
    decode_each,
)
from edgectl.formats.document import Document, Fault, Faults, FieldPath
from edgectl.formats.object_fields import Amounts, Field, Group, decode_member, encode_member
from edgectl.formats.object_schema import describe_class, describe_field
from edgectl.formats.scalar_codecs import (
    Codec,
    Schema,
    compile_converted,
    compile_enum,
    compile_instant,
    compile_number,
    compile_plain,
    compile_resource,
    is_type,
    make_optional,
    report_absent,
)
from edgectl.model.encoding import (
    METADATA_KEY,
    PLAIN_KEY,
    Bounds,
    ColumnFormat,
    Converted,
    DocumentKey,
    EachAlone,
    InstantFormat,
    Rounded,
)
from edgectl.model.resource import Resource, ResourceMap

Model = TypeVar("Model")


def encode(value: object) -> Document:
    """The JSON object of a dataclass."""
    kind: Any = type(value)
    document: Document = compile_type(kind).encode(value)
    return document


def decode(kind: type[Model], raw: object, faults: Faults) -> Model:
    """The value of type ``kind`` in a JSON value; of no use where ``faults`` were found."""
    wanted: Any = kind
    value: Model = compile_type(wanted).decode(raw, (), faults)
    return value


def decode_again(
    kind: type[Model], raw: Mapping[str, Any], faults: Faults, before: Mapping[str, Any], known: Model
) -> Model:
    """As `decode`, of a dataclass that was ``known`` when its object was ``before``: a value that is the very
    same object in both is not decoded again, nor is such an entry of a mapping whose entries stand alone.
    """
    wanted: Any = kind
    values: dict[str, Any] = {}
    for member in list_members(wanted):
        if isinstance(member, Field) and not member.place.inline:
            found, was = raw.get(member.key), before.get(member.key)
            if found is was and (found is not None or _is_left_out(member, raw, before)):
                values[member.name] = getattr(known, member.name)
                continue
            if member.codec.again is not None:
                again = member.codec.again(found, was, getattr(known, member.name))
                if again is not None:
                    values[member.name] = again
                    continue
        decode_member(member, raw, (), faults, values)
    return kind(**values) if not faults else known


def _is_left_out(member: Field, raw: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    """Whether neither object has the key of a member that is needed in none."""
    return member.place.needed_when is None and member.key not in raw and member.key not in before


def build_document_schema(name: str, version: int, kind: type) -> Schema:
    """JSON Schema of a document that holds a ``kind`` beside its version."""
    found: Schema = {}
    schema = compile_type(kind).schema(found)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": name,
        "description": f"edgectl: {name}. Written by edgectl schema.",
        "type": "object",
        "properties": {"format_version": {"const": version}},
        "required": ["format_version"],
        "allOf": [schema],
        "$defs": found,
    }


@cache
def compile_type(kind: Any) -> Codec:  # noqa: ANN401 - a type, also a generic one
    """The codec of a type.

    Raises:
        TypeError: no document can hold such values.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _compile_annotated(arguments[0], arguments[1:])
    if origin in (Union, types.UnionType):
        return _compile_optional(arguments)
    if origin in (tuple, Sequence):
        size = None if origin is Sequence or arguments[-1] is Ellipsis else len(arguments)
        return compile_tuple(compile_type(arguments[0]), size)
    if origin is frozenset:
        return compile_set(compile_type(arguments[0]))
    if origin is not None and issubclass(origin, Mapping):
        return compile_mapping(compile_type(arguments[0]), compile_type(arguments[1]))
    if kind is Resource:
        return compile_resource()
    if isinstance(kind, type) and issubclass(kind, ResourceMap):
        item = get_args(kind.__orig_bases__[0])[0]  # type: ignore[attr-defined]
        return compile_resource_map(kind, compile_type(item))
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return compile_enum(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        return _compile_class(kind)
    return _compile_scalar(kind)


def _compile_scalar(kind: Any) -> Codec:  # noqa: ANN401
    if kind in (float, int):
        return compile_number(kind, Bounds(), Rounded())
    if kind in (str, bool):
        return compile_plain(kind)
    if kind is object:
        return Codec(lambda value: value, lambda raw, _path, _faults: raw, lambda _found: {})
    raise TypeError(f"no document holds values of type {kind}")


def _compile_annotated(kind: Any, marks: tuple[object, ...]) -> Codec:  # noqa: ANN401
    bounds, rounded = Bounds(), Rounded()
    for mark in marks:
        if isinstance(mark, InstantFormat):
            return compile_instant()
        if isinstance(mark, ColumnFormat):
            return _compile_columns(get_args(kind)[0])
        if isinstance(mark, EachAlone):
            return _compile_each_alone(get_origin(kind), get_args(kind))
        if isinstance(mark, Converted):
            return compile_converted(compile_type(kind), mark.convert)
        if isinstance(mark, Bounds):
            bounds = mark
        if isinstance(mark, Rounded):
            rounded = mark
    return compile_number(kind, bounds, rounded)


def _compile_each_alone(origin: Any, arguments: tuple[Any, ...]) -> Codec:  # noqa: ANN401
    if origin is tuple:
        return compile_tuple_alone(compile_type(arguments[0]))
    return compile_mapping_alone(compile_type(arguments[0]), compile_type(arguments[1]))


def _compile_optional(arguments: tuple[Any, ...]) -> Codec:
    return make_optional(compile_type(_strip_none(arguments)))


def _strip_none(arguments: tuple[Any, ...]) -> Any:  # noqa: ANN401
    (kind,) = (each for each in arguments if each is not type(None))
    return kind


def _compile_amounts(name: str, hint: Any, place: DocumentKey) -> Amounts:  # noqa: ANN401
    bounds = Bounds()
    if get_origin(hint) is Annotated:
        hint, bounds = get_args(hint)[0], get_args(hint)[1]
    kind = get_origin(hint) or hint
    value_type = next((each for each in get_args(hint) if is_dataclass(each)), None)
    if value_type is None:
        codecs = [compile_number(float, bounds, Rounded())]
    else:
        hints = get_type_hints(value_type, include_extras=True)
        codecs = [compile_type(hints[part]) for part in place.by_resource]
    return Amounts(name, kind, value_type, tuple(zip(place.by_resource, codecs, strict=True)), place)


@cache
def _compile_class(kind: Any) -> Codec:  # noqa: ANN401
    members = list_members(kind)

    def encode_object(value: Any) -> Document:  # noqa: ANN401
        document: Document = {}
        for member in members:
            encode_member(member, value, document)
        return document

    def decode_object(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, dict, path, faults):
            return None
        before = len(faults)
        values: dict[str, Any] = {}
        for member in members:
            decode_member(member, raw, path, faults, values)
        return kind(**values) if len(faults) == before else None

    def describe(found: Schema) -> Schema:
        if kind.__name__ not in found:
            found[kind.__name__] = {}
            found[kind.__name__] = describe_class(kind, members, found)
        return {"$ref": f"#/$defs/{kind.__name__}"}

    return Codec(encode_object, decode_object, describe)


@cache
def list_members(kind: Any) -> list[Field | Group | Amounts]:  # noqa: ANN401
    """The members of the object of a dataclass."""
    hints = get_type_hints(kind, include_extras=True)
    members: dict[str, Field | Amounts | list[Field]] = {}
    for item in fields(kind):
        place: DocumentKey = item.metadata.get(METADATA_KEY, PLAIN_KEY)
        if place.by_resource:
            members[item.name] = _compile_amounts(item.name, hints[item.name], place)
            continue
        group, _, key = (place.key or item.name).rpartition(".")
        hint = hints[item.name]
        default = item.default_factory() if item.default_factory is not MISSING else item.default
        member = Field(
            item.name, key, _compile_member(hint, place), default, type(None) in get_args(hint), place
        )
        if not group:
            members[item.name] = member
            continue
        together = members.setdefault(group, [])
        assert isinstance(together, list), group  # noqa: S101 - a key is a group or a value
        together.append(member)
    return [Group(key, tuple(value)) if isinstance(value, list) else value for key, value in members.items()]


def _compile_member(hint: Any, place: DocumentKey) -> Codec:  # noqa: ANN401
    arguments = get_args(hint)
    if type(None) in arguments:
        return make_optional(_compile_member(_strip_none(arguments), place))
    if place.keyed_by:
        return _compile_keyed(arguments[0], place.keyed_by)
    if place.entries:
        return compile_entries(compile_type(arguments[1]), place.entries, place.value_key)
    if place.value_key:
        return compile_mapping(
            compile_type(arguments[0]), compile_wrapped(compile_type(arguments[1]), place.value_key)
        )
    return compile_type(hint)


def _compile_keyed(kind: Any, by: str) -> Codec:  # noqa: ANN401
    """A tuple of dataclasses as an object, keyed by the field ``by``."""
    item = compile_type(kind)
    key = compile_type(get_type_hints(kind)[by])

    def decode_keyed(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, dict, path, faults):
            return None
        pairs = ((name, inner if isinstance(inner, dict) else None) for name, inner in raw.items())
        return tuple(
            item.decode({by: name, **inner} if inner is not None else raw[name], (*path, name), faults)
            for name, inner in pairs
        )

    def describe(found: Schema) -> Schema:
        schema = describe_class(
            kind, [each for each in list_members(kind) if isinstance(each, Field) and each.key != by], found
        )
        names = key.schema(found)
        return {"type": "object", "additionalProperties": schema, "propertyNames": names}

    def encode_keyed(values: Any) -> Document:  # noqa: ANN401
        encoded = [item.encode(value) for value in values]
        return {each.pop(by): each for each in encoded}

    return Codec(encode_keyed, decode_keyed, describe)


def _compile_columns(kind: Any) -> Codec:  # noqa: ANN401
    """A tuple of dataclasses as an object of lists that are equally long."""
    members = [member for member in list_members(kind) if isinstance(member, Field)]
    keys = ", ".join(member.key for member in members)

    def decode_columns(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not is_type(raw, dict, path, faults):
            return None
        before = len(faults)
        columns = [_decode_column(member, raw, path, faults) for member in members]
        if len(faults) == before and len({len(column) for column in columns}) > 1:
            faults.append(Fault(path=path, message=f"{keys} must be equally long"))
        if len(faults) > before:
            return None
        names = [member.name for member in members]
        return tuple(kind(**dict(zip(names, row, strict=True))) for row in zip(*columns, strict=True))

    def describe(found: Schema) -> Schema:
        lists = {member.key: {"type": "array", "items": describe_field(member, found)} for member in members}
        return {"type": "object", "properties": lists, "required": list(lists)}

    return Codec(
        lambda values: {
            member.key: [member.codec.encode(getattr(value, member.name)) for value in values]
            for member in members
        },
        decode_columns,
        describe,
    )


def _decode_column(member: Field, raw: Mapping[str, Any], path: FieldPath, faults: Faults) -> list[Any]:
    column = raw.get(member.key)
    if column is None:
        report_absent(member.key, raw, path, faults)
    elif is_type(column, list, (*path, member.key), faults):
        return decode_each(member.codec, column, (*path, member.key), faults)
    return []
