"""Dataclasses to JSON and back by their types and ``edgectl.model.encoding``: every fault at once, each with
its path.

``compile_type`` turns a type into a ``Codec`` once; a dataclass is an object, a mapping an object, a tuple a
list. Keys that a class does not have are ignored. A value that is wrong is a fault and decodes to None, so
that decoding goes on.
"""

import math
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

from edgectl.formats.document import Document, Fault, Faults, FieldPath, encode_number
from edgectl.model.encoding import (
    METADATA_KEY,
    PLAIN_KEY,
    Bounds,
    ColumnFormat,
    Converted,
    DocumentKey,
    InstantFormat,
    Rounded,
)
from edgectl.model.resource import RESOURCES, RESOURCES_BY_NAME, Resource, ResourceMap
from edgectl.units import QuantityError, format_instant, parse_instant

Schema = dict[str, Any]
Model = TypeVar("Model")
_JSON_TYPE_NAMES = {
    dict: "an object",
    list: "a list",
    str: "a string",
    bool: "true or false",
    int: "a number",
    float: "a number",
    type(None): "null",
}


class Codec(NamedTuple):
    """How values of one type are encoded, decoded and described.

    ``schema`` collects the schemas of classes in its argument.
    """

    encode: Callable[[Any], Any]
    decode: Callable[[Any, FieldPath, Faults], Any]
    schema: Callable[[Schema], Schema]


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


def describe_json_type(raw: object) -> str:
    """The type of a JSON value, in words."""
    return _JSON_TYPE_NAMES.get(type(raw), type(raw).__name__)


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
    if origin is tuple:
        return _compile_tuple(arguments)
    if origin is frozenset:
        return _compile_set(compile_type(arguments[0]))
    if origin is not None and issubclass(origin, Mapping):
        return _compile_mapping(compile_type(arguments[0]), compile_type(arguments[1]))
    if kind is Resource:
        return _compile_resource()
    if isinstance(kind, type) and issubclass(kind, ResourceMap):
        return _compile_resource_map(kind)
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return _compile_enum(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        return _compile_class(kind)
    return _compile_scalar(kind)


def _compile_scalar(kind: Any) -> Codec:  # noqa: ANN401
    if kind in (float, int):
        return _compile_number(kind, Bounds(), Rounded())
    if kind in (str, bool):
        return _compile_plain(kind)
    if kind is object:
        return Codec(lambda value: value, lambda raw, _path, _faults: raw, lambda _found: {})
    raise TypeError(f"no document holds values of type {kind}")


def _compile_annotated(kind: Any, marks: tuple[object, ...]) -> Codec:  # noqa: ANN401
    bounds, rounded = Bounds(), Rounded()
    for mark in marks:
        if isinstance(mark, InstantFormat):
            return Codec(
                format_instant, _decode_instant, lambda _found: {"type": "string", "format": "date-time"}
            )
        if isinstance(mark, ColumnFormat):
            return _compile_columns(get_args(kind)[0])
        if isinstance(mark, Converted):
            return _compile_converted(compile_type(kind), mark.convert)
        if isinstance(mark, Bounds):
            bounds = mark
        if isinstance(mark, Rounded):
            rounded = mark
    return _compile_number(kind, bounds, rounded)


def _compile_converted(codec: Codec, convert: Callable[[Any], Any]) -> Codec:
    def decode_value(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        value = codec.decode(raw, path, faults)
        return None if value is None else convert(value)

    return codec._replace(decode=decode_value)


def _decode_instant(raw: object, path: FieldPath, faults: Faults) -> float | None:
    try:
        return parse_instant(raw)
    except QuantityError as error:
        faults.append(Fault(path=path, message=error.message, hint=error.hint))
        return None


def _compile_number(kind: type, bounds: Bounds, rounded: Rounded) -> Codec:
    least = -math.inf if bounds.minimum is None else bounds.minimum
    most = math.inf if bounds.maximum is None else bounds.maximum
    whole = kind is int

    def decode_number(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if type(raw) is not int and (whole or type(raw) is not float):
            word = "a whole number" if whole else "a number"
            faults.append(Fault(path=path, message=f"must be {word}, not {describe_json_type(raw)}"))
            return None
        value = raw if whole else _to_float(raw)
        if (
            value < least
            or value > most
            or (bounds.above and value == least)
            or not (whole or math.isfinite(value))
        ):
            faults.append(Fault(path=path, message=_explain_bounds(raw, value, bounds, whole=whole)))
            return None
        return value

    return Codec(
        _make_number_encoder(whole=whole, rounded=rounded),
        decode_number,
        lambda _found: _describe_number(kind, bounds),
    )


def _to_float(raw: float) -> float:
    try:
        return float(raw)
    except OverflowError:
        return math.inf


def _explain_bounds(raw: object, value: float, bounds: Bounds, *, whole: bool) -> str:
    if not whole and not math.isfinite(value):
        return "must be a finite number"
    if bounds.maximum is not None and value > bounds.maximum:
        return f"must be {bounds.maximum:g} or less, not {raw}"
    return (
        f"must be above {bounds.minimum:g}, not {raw}"
        if bounds.above
        else f"must be {bounds.minimum:g} or more, not {raw}"
    )


def _make_number_encoder(*, whole: bool, rounded: Rounded) -> Callable[[Any], Any]:
    decimals, digits = rounded.decimals, rounded.digits
    if decimals is not None:
        return lambda value: encode_number(round(value, decimals))
    if digits is not None:
        return lambda value: encode_number(float(f"{value:.{digits}g}"))
    return int if whole else encode_number


def _describe_number(kind: type, bounds: Bounds) -> Schema:
    schema: Schema = {"type": "integer" if kind is int else "number"}
    if bounds.minimum is not None:
        schema["exclusiveMinimum" if bounds.above else "minimum"] = encode_number(bounds.minimum)
    if bounds.maximum is not None:
        schema["maximum"] = encode_number(bounds.maximum)
    return schema


def _compile_plain(kind: type) -> Codec:
    words, name = ("true or false", "boolean") if kind is bool else ("a string", "string")

    def decode_plain(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if type(raw) is kind:
            return raw
        faults.append(Fault(path=path, message=f"must be {words}, not {describe_json_type(raw)}"))
        return None

    return Codec(kind, decode_plain, lambda _found: {"type": name})


def _compile_enum(kind: type[StrEnum]) -> Codec:
    return _compile_words({word.value: word for word in kind}, lambda value: str(value.value))


def _compile_resource() -> Codec:
    return _compile_words(RESOURCES_BY_NAME, lambda value: str(value.name))


def _compile_words(known: Mapping[str, Any], name_of: Callable[[Any], str]) -> Codec:
    def decode_word(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        found = known.get(raw) if isinstance(raw, str) else None
        if found is None:
            wrong = f"must be a word, not {describe_json_type(raw)}"
            message = f"unknown {path[-1] if path else 'word'}: {raw!r}" if isinstance(raw, str) else wrong
            faults.append(Fault(path=path, message=message, hint="write one of " + ", ".join(known)))
        return found

    return Codec(name_of, decode_word, lambda _found: {"enum": list(known)})


def _compile_optional(arguments: tuple[Any, ...]) -> Codec:
    return _make_optional(compile_type(_strip_none(arguments)))


def _strip_none(arguments: tuple[Any, ...]) -> Any:  # noqa: ANN401
    (kind,) = (each for each in arguments if each is not type(None))
    return kind


def _make_optional(inner: Codec) -> Codec:
    return Codec(
        lambda value: None if value is None else inner.encode(value),
        lambda raw, path, faults: None if raw is None else inner.decode(raw, path, faults),
        lambda found: _allow_null(inner.schema(found)),
    )


def _allow_null(schema: Schema) -> Schema:
    if isinstance(schema.get("type"), str):
        return schema | {"type": [schema["type"], "null"]}
    if "enum" in schema:
        return schema | {"enum": [*schema["enum"], None]}
    return {"anyOf": [schema, {"type": "null"}]}


def _decode_each(codec: Codec, raw: list[Any], path: FieldPath, faults: Faults) -> list[Any]:
    return [_decode_inner(codec, inner, (*path, index), faults) for index, inner in enumerate(raw)]


def _decode_inner(codec: Codec, raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
    """A value of a list or of an object, where null says nothing."""
    if raw is None:
        faults.append(Fault(path=path, message="must not be null"))
        return None
    return codec.decode(raw, path, faults)


def _is_type(raw: object, kind: type, path: FieldPath, faults: Faults) -> bool:
    if isinstance(raw, kind):
        return True
    faults.append(
        Fault(path=path, message=f"must be {_JSON_TYPE_NAMES[kind]}, not {describe_json_type(raw)}")
    )
    return False


def _compile_tuple(arguments: tuple[Any, ...]) -> Codec:
    item = compile_type(arguments[0])
    size = None if arguments[-1] is Ellipsis else len(arguments)

    def decode_list(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not _is_type(raw, list, path, faults):
            return None
        if size is not None and len(raw) != size:
            faults.append(Fault(path=path, message=f"must be a list of {size}, not of {len(raw)}"))
            return None
        return tuple(_decode_each(item, raw, path, faults))

    limits = {} if size is None else {"minItems": size, "maxItems": size}
    return Codec(
        lambda values: [item.encode(value) for value in values],
        decode_list,
        lambda found: {"type": "array", "items": item.schema(found)} | limits,
    )


def _compile_set(item: Codec) -> Codec:
    def decode_set(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        return frozenset(_decode_each(item, raw, path, faults)) if _is_type(raw, list, path, faults) else None

    return Codec(
        lambda values: sorted(item.encode(value) for value in values),
        decode_set,
        lambda found: {"type": "array", "items": item.schema(found), "uniqueItems": True},
    )


def _compile_mapping(key: Codec, item: Codec) -> Codec:
    def decode_mapping(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not _is_type(raw, dict, path, faults):
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


def _compile_resource_map(kind: type[ResourceMap[Any]]) -> Codec:
    """Values by the names of a table.

    One that is absent has its default where that is 0 or null, else it must be there.
    """
    item = compile_type(get_args(kind.__orig_bases__[0])[0])  # type: ignore[attr-defined]

    def decode_map(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not _is_type(raw, dict, path, faults):
            return None
        values = {}
        for name, default in kind.DEFAULTS.items():
            if raw.get(name) is not None:
                values[name] = item.decode(raw[name], (*path, name), faults)
            elif default:
                _report_absent(name, raw, path, faults)
        return kind(values)

    def describe(found: Schema) -> Schema:
        needed = [name for name, default in kind.DEFAULTS.items() if default]
        properties = {name: item.schema(found) for name in kind.DEFAULTS}
        return {"type": "object", "properties": properties} | ({"required": needed} if needed else {})

    return Codec(
        lambda values: {name: item.encode(value) for name, value in values.items()}, decode_map, describe
    )


@dataclass(frozen=True, slots=True)
class _Amounts:
    """A field whose amounts stand in one object per resource. ``parts``: name and codec of each amount."""

    name: str
    kind: Any
    value_type: Any
    parts: tuple[tuple[str, Codec], ...]
    place: DocumentKey

    @property
    def resources(self) -> tuple[Resource, ...]:
        """The resources that may be there."""
        return tuple(each for each in RESOURCES if not (self.place.host_only and each.per_link))

    def is_required(self, resource: Resource) -> bool:
        """Whether a resource must be there, unless the field is needed only under a condition."""
        may_be_unknown = (
            resource.per_link and self.value_type is None and not issubclass(self.kind, ResourceMap)
        )
        return not (resource.declared_only or may_be_unknown)


def _compile_amounts(name: str, hint: Any, place: DocumentKey) -> _Amounts:  # noqa: ANN401
    bounds = Bounds()
    if get_origin(hint) is Annotated:
        hint, bounds = get_args(hint)[0], get_args(hint)[1]
    kind = get_origin(hint) or hint
    value_type = next((each for each in get_args(hint) if is_dataclass(each)), None)
    if value_type is None:
        codecs = [_compile_number(float, bounds, Rounded())]
    else:
        hints = get_type_hints(value_type, include_extras=True)
        codecs = [compile_type(hints[part]) for part in place.by_resource]
    return _Amounts(name, kind, value_type, tuple(zip(place.by_resource, codecs, strict=True)), place)


def _encode_amounts(member: _Amounts, value: object, document: Document) -> None:
    amounts = getattr(value, member.name)
    for resource in member.resources:
        amount = amounts.get(resource.name)
        if amount is None or (not amount and resource.declared_only):
            continue
        unit = resource.unit.name
        document[resource.name] = {
            f"{part}_{unit}": codec.encode(amount if member.value_type is None else getattr(amount, part))
            for part, codec in member.parts
        }


def _decode_amounts(
    member: _Amounts,
    raw: Any,  # noqa: ANN401
    path: FieldPath,
    faults: Faults,
    values: dict[str, Any],
) -> None:
    needed = _is_needed(member.place, values) if member.place.needed_when else True
    decoded: dict[str, Any] = {}
    for resource in member.resources:
        inner = raw.get(resource.name)
        if inner is None:
            if needed and member.is_required(resource):
                _report_absent(resource.name, raw, path, faults)
        elif _is_type(inner, dict, (*path, resource.name), faults):
            decoded[resource.name] = _decode_parts(member, resource, inner, (*path, resource.name), faults)
    values[member.name] = member.kind(decoded) if issubclass(member.kind, ResourceMap) else decoded


def _decode_parts(
    member: _Amounts, resource: Resource, raw: Mapping[str, Any], path: FieldPath, faults: Faults
) -> Any:  # noqa: ANN401
    before, found = len(faults), {}
    for part, codec in member.parts:
        key = f"{part}_{resource.unit.name}"
        if raw.get(key) is None:
            _report_absent(key, raw, path, faults)
        else:
            found[part] = codec.decode(raw[key], (*path, key), faults)
    if len(faults) > before:
        return None
    return found[member.parts[0][0]] if member.value_type is None else member.value_type(**found)


@dataclass(frozen=True, slots=True)
class _Field:
    """One field of a class.

    ``default``: MISSING where it must be there; ``nullable``: absent and null both mean None.
    """

    name: str
    key: str
    codec: Codec
    default: object
    nullable: bool
    place: DocumentKey


@dataclass(frozen=True, slots=True)
class _Group:
    """Fields of a class that stand in an object of their own under ``key``."""

    key: str
    members: tuple["_Field", ...]


@cache
def _compile_class(kind: Any) -> Codec:  # noqa: ANN401
    members = _list_members(kind)

    def encode_object(value: Any) -> Document:  # noqa: ANN401
        document: Document = {}
        for member in members:
            _encode_member(member, value, document)
        return document

    def decode_object(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not _is_type(raw, dict, path, faults):
            return None
        before = len(faults)
        values: dict[str, Any] = {}
        for member in members:
            _decode_member(member, raw, path, faults, values)
        return kind(**values) if len(faults) == before else None

    def describe(found: Schema) -> Schema:
        if kind.__name__ not in found:
            found[kind.__name__] = {}
            found[kind.__name__] = _describe_class(kind, members, found)
        return {"$ref": f"#/$defs/{kind.__name__}"}

    return Codec(encode_object, decode_object, describe)


def _encode_member(member: "_Field | _Group | _Amounts", value: Any, document: Document) -> None:  # noqa: ANN401
    if isinstance(member, _Group):
        if inner := _encode_fields(value, member.members):
            document[member.key] = inner
    elif isinstance(member, _Amounts):
        _encode_amounts(member, value, document)
    elif member.place.inline:
        document |= member.codec.encode(getattr(value, member.name))
    else:
        _encode_field(value, member, document)


def _decode_member(
    member: "_Field | _Group | _Amounts",
    raw: Any,  # noqa: ANN401
    path: FieldPath,
    faults: Faults,
    values: dict[str, Any],
) -> None:
    if isinstance(member, _Group):
        _decode_group(member, raw, path, faults, values)
    elif isinstance(member, _Amounts):
        _decode_amounts(member, raw, path, faults, values)
    else:
        _decode_field(member, raw, path, faults, values)


def _list_members(kind: Any) -> list[_Field | _Group | _Amounts]:  # noqa: ANN401
    hints = get_type_hints(kind, include_extras=True)
    members: dict[str, _Field | _Amounts | list[_Field]] = {}
    for item in fields(kind):
        place: DocumentKey = item.metadata.get(METADATA_KEY, PLAIN_KEY)
        if place.by_resource:
            members[item.name] = _compile_amounts(item.name, hints[item.name], place)
            continue
        group, _, key = (place.key or item.name).rpartition(".")
        hint = hints[item.name]
        default = item.default_factory() if item.default_factory is not MISSING else item.default
        member = _Field(
            item.name, key, _compile_member(hint, place), default, type(None) in get_args(hint), place
        )
        if not group:
            members[item.name] = member
            continue
        together = members.setdefault(group, [])
        assert isinstance(together, list), group  # noqa: S101 - a key is a group or a value
        together.append(member)
    return [_Group(key, tuple(value)) if isinstance(value, list) else value for key, value in members.items()]


def _compile_member(hint: Any, place: DocumentKey) -> Codec:  # noqa: ANN401
    arguments = get_args(hint)
    if type(None) in arguments:
        return _make_optional(_compile_member(_strip_none(arguments), place))
    if place.keyed_by:
        return _compile_keyed(arguments[0], place.keyed_by)
    if place.entries:
        return _compile_entries(compile_type(arguments[1]), place.entries, place.value_key)
    if place.value_key:
        return _compile_mapping(
            compile_type(arguments[0]), _compile_wrapped(compile_type(arguments[1]), place.value_key)
        )
    return compile_type(hint)


def _encode_fields(value: object, members: tuple[_Field, ...]) -> Document:
    document: Document = {}
    for member in members:
        _encode_field(value, member, document)
    return document


def _encode_field(value: object, member: _Field, document: Document) -> None:
    inner = getattr(value, member.name)
    if member.place.always or (inner is not member.default and inner != member.default):
        document[member.key] = member.codec.encode(inner)


def _decode_group(member: _Group, raw: Any, path: FieldPath, faults: Faults, values: dict[str, Any]) -> None:  # noqa: ANN401
    inner = raw.get(member.key)
    if inner is None:
        if any(_is_required(each) for each in member.members):
            _report_absent(member.key, raw, path, faults)
    elif _is_type(inner, dict, (*path, member.key), faults):
        for each in member.members:
            _decode_field(each, inner, (*path, member.key), faults, values)


def _decode_field(member: _Field, raw: Any, path: FieldPath, faults: Faults, values: dict[str, Any]) -> None:  # noqa: ANN401
    if member.place.inline:
        values[member.name] = member.codec.decode(raw, path, faults)
        return
    found = raw.get(member.key)
    if found is not None:
        values[member.name] = member.codec.decode(found, (*path, member.key), faults)
    elif _is_required(member) or _is_needed(member.place, values):
        _report_absent(member.key, raw, path, faults)
    elif member.default is MISSING or (member.nullable and member.key in raw):
        values[member.name] = None


def _is_required(member: _Field) -> bool:
    return member.place.required or (member.default is MISSING and not member.nullable)


def _is_needed(place: DocumentKey, values: Mapping[str, Any]) -> bool:
    """Whether another field asks for this one; one that is wrong itself may do so."""
    if place.needed_when is None:
        return False
    other, word = place.needed_when
    return values.get(other) in (None, word)


def _report_absent(key: str, raw: Mapping[str, Any], path: FieldPath, faults: Faults) -> None:
    if key in raw:
        faults.append(Fault(path=(*path, key), message="must not be null"))
    else:
        faults.append(Fault(path=path, message=f"{key} is missing", hint=f"add {key}"))


def _compile_wrapped(item: Codec, key: str) -> Codec:
    """A value in an object of one key."""

    def decode_wrapped(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not _is_type(raw, dict, path, faults):
            return None
        if raw.get(key) is None:
            return _report_absent(key, raw, path, faults)
        return item.decode(raw[key], (*path, key), faults)

    return Codec(
        lambda value: {key: item.encode(value)},
        decode_wrapped,
        lambda found: {"type": "object", "properties": {key: item.schema(found)}, "required": [key]},
    )


def _compile_entries(item: Codec, parts: tuple[str, ...], value_key: str) -> Codec:
    """A mapping by tuples as a list of objects."""
    inner = _compile_wrapped(item, value_key) if value_key else item
    names = [_compile_wrapped(compile_type(str), part) for part in parts]

    def decode_entries(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not _is_type(raw, list, path, faults):
            return None
        decoded: dict[Any, Any] = {}
        for index, entry in enumerate(raw):
            place = (*path, index)
            if _is_type(entry, dict, place, faults):
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


def _compile_keyed(kind: Any, by: str) -> Codec:  # noqa: ANN401
    """A tuple of dataclasses as an object, keyed by the field ``by``."""
    item = compile_type(kind)
    key = compile_type(get_type_hints(kind)[by])

    def decode_keyed(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not _is_type(raw, dict, path, faults):
            return None
        pairs = ((name, inner if isinstance(inner, dict) else None) for name, inner in raw.items())
        return tuple(
            item.decode({by: name, **inner} if inner is not None else raw[name], (*path, name), faults)
            for name, inner in pairs
        )

    def describe(found: Schema) -> Schema:
        schema = _describe_class(
            kind, [each for each in _list_members(kind) if isinstance(each, _Field) and each.key != by], found
        )
        names = key.schema(found)
        return {"type": "object", "additionalProperties": schema, "propertyNames": names}

    def encode_keyed(values: Any) -> Document:  # noqa: ANN401
        encoded = [item.encode(value) for value in values]
        return {each.pop(by): each for each in encoded}

    return Codec(encode_keyed, decode_keyed, describe)


def _compile_columns(kind: Any) -> Codec:  # noqa: ANN401
    """A tuple of dataclasses as an object of lists that are equally long."""
    members = [member for member in _list_members(kind) if isinstance(member, _Field)]
    keys = ", ".join(member.key for member in members)

    def decode_columns(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if not _is_type(raw, dict, path, faults):
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
        lists = {member.key: {"type": "array", "items": _describe_field(member, found)} for member in members}
        return {"type": "object", "properties": lists, "required": list(lists)}

    return Codec(
        lambda values: {
            member.key: [member.codec.encode(getattr(value, member.name)) for value in values]
            for member in members
        },
        decode_columns,
        describe,
    )


def _decode_column(member: _Field, raw: Mapping[str, Any], path: FieldPath, faults: Faults) -> list[Any]:
    column = raw.get(member.key)
    if column is None:
        _report_absent(member.key, raw, path, faults)
    elif _is_type(column, list, (*path, member.key), faults):
        return _decode_each(member.codec, column, (*path, member.key), faults)
    return []


# Endings of keys -> the unit, longest first.
_UNITS = {
    "bytes_per_s": "bytes per second",
    "cores": "cores",
    "bytes": "bytes",
    "_ms": "milliseconds",
    "_s": "seconds",
    "_c": "degrees Celsius",
}


def _describe_class(kind: Any, members: list[_Field | _Group | _Amounts], found: Schema) -> Schema:  # noqa: ANN401
    properties: Schema = {}
    required: list[str] = []
    conditions: list[Schema] = []
    for member in members:
        if isinstance(member, _Group):
            inner = {each.key: _describe_field(each, found) for each in member.members}
            needed = [each.key for each in member.members if _is_required(each)]
            properties[member.key] = {"type": "object", "properties": inner} | (
                {"required": needed} if needed else {}
            )
            required += [member.key] if needed else []
        elif isinstance(member, _Amounts):
            objects, needed = _describe_amounts(member, found)
            properties |= objects
            required += needed if member.place.needed_when is None else []
            conditions += _describe_need(member.place, needed)
        elif member.place.inline:
            conditions.append(member.codec.schema(found))
        else:
            properties[member.key] = _describe_field(member, found)
            required += [member.key] if _is_required(member) else []
            conditions += _describe_need(member.place, [member.key])
    schema: Schema = {
        "type": "object",
        "description": (kind.__doc__ or "").strip().split("\n")[0],
        "properties": properties,
    }
    return (
        schema | ({"required": required} if required else {}) | ({"allOf": conditions} if conditions else {})
    )


def _describe_field(member: _Field, found: Schema) -> Schema:
    schema = member.codec.schema(found)
    if member.default is not MISSING and not member.nullable and not _is_required(member):
        schema = _allow_null(schema)
    unit = next((words for ending, words in _UNITS.items() if member.key.endswith(ending)), "")
    is_number = schema.get("type") in ("number", "integer", ["number", "null"], ["integer", "null"])
    return schema | {"description": unit} if unit and is_number else schema


def _describe_amounts(member: _Amounts, found: Schema) -> tuple[Schema, list[str]]:
    objects: Schema = {}
    for resource in member.resources:
        unit = resource.unit.name
        amounts = {
            f"{part}_{unit}": codec.schema(found) | {"description": unit} for part, codec in member.parts
        }
        objects[resource.name] = {"type": "object", "properties": amounts, "required": list(amounts)}
    return objects, [each.name for each in member.resources if member.is_required(each)]


def _describe_need(place: DocumentKey, keys: list[str]) -> list[Schema]:
    if place.needed_when is None:
        return []
    other, word = place.needed_when
    return [{"if": {"properties": {other: {"const": word}}}, "then": {"required": keys}}]
