# SPDX-License-Identifier: Apache-2.0
"""Codecs of numbers, texts, words, instants and null, and their JSON Schemas."""

import math
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any, NamedTuple

from edgectl.formats.document import Fault, Faults, FieldPath, encode_number
from edgectl.model.encoding import Bounds, Rounded
from edgectl.model.resource import RESOURCES_BY_NAME
from edgectl.units import QuantityError, format_instant, parse_instant

Schema = dict[str, Any]


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

    ``schema`` collects the schemas of classes in its argument. ``again``: the value of a JSON value, from one
    before and what that was decoded to; None where it has to be decoded.
    """

    encode: Callable[[Any], Any]
    decode: Callable[[Any, FieldPath, Faults], Any]
    schema: Callable[[Schema], Schema]
    again: Callable[[Any, Any, Any], Any] | None = None


def describe_json_type(raw: object) -> str:
    """The type of a JSON value, in words."""
    return _JSON_TYPE_NAMES.get(type(raw), type(raw).__name__)


def is_type(raw: object, kind: type, path: FieldPath, faults: Faults) -> bool:
    """Whether a JSON value has a type; where it has another, that is a fault."""
    if isinstance(raw, kind):
        return True
    faults.append(
        Fault(path=path, message=f"must be {_JSON_TYPE_NAMES[kind]}, not {describe_json_type(raw)}")
    )
    return False


def report_absent(key: str, raw: Mapping[str, Any], path: FieldPath, faults: Faults) -> None:
    """Add the fault of a key that is missing, or null."""
    if key in raw:
        faults.append(Fault(path=(*path, key), message="must not be null"))
    else:
        faults.append(Fault(path=path, message=f"{key} is missing", hint=f"add {key}"))


def compile_converted(codec: Codec, convert: Callable[[Any], Any]) -> Codec:
    """The codec of values that are converted once they are decoded."""

    def decode_value(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        before = len(faults)
        value = codec.decode(raw, path, faults)
        return convert(value) if value is not None and len(faults) == before else None

    return codec._replace(decode=decode_value)


def _decode_instant(raw: object, path: FieldPath, faults: Faults) -> float | None:
    try:
        return parse_instant(raw)
    except QuantityError as error:
        faults.append(Fault(path=path, message=error.message, hint=error.hint))
        return None


def compile_instant() -> Codec:
    """Seconds since 1970 as an RFC 3339 text."""
    return Codec(format_instant, _decode_instant, lambda _found: {"type": "string", "format": "date-time"})


def compile_number(kind: type, bounds: Bounds, rounded: Rounded) -> Codec:
    """A number within ``bounds``, rounded where it is encoded."""
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


def compile_plain(kind: type) -> Codec:
    """A text, or true or false."""
    words, name = ("true or false", "boolean") if kind is bool else ("a string", "string")

    def decode_plain(raw: Any, path: FieldPath, faults: Faults) -> Any:  # noqa: ANN401
        if type(raw) is kind:
            return raw
        faults.append(Fault(path=path, message=f"must be {words}, not {describe_json_type(raw)}"))
        return None

    return Codec(kind, decode_plain, lambda _found: {"type": name})


def compile_enum(kind: type[StrEnum]) -> Codec:
    """A member of an enumeration as its word."""
    return _compile_words({word.value: word for word in kind}, lambda value: str(value.value))


def compile_resource() -> Codec:
    """A resource as its name."""
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


def make_optional(inner: Codec) -> Codec:
    """``inner``, or null for None."""
    return Codec(
        lambda value: None if value is None else inner.encode(value),
        lambda raw, path, faults: None if raw is None else inner.decode(raw, path, faults),
        lambda found: allow_null(inner.schema(found)),
    )


def allow_null(schema: Schema) -> Schema:
    """``schema``, or null."""
    if isinstance(schema.get("type"), str):
        return schema | {"type": [schema["type"], "null"]}
    if "enum" in schema:
        return schema | {"enum": [*schema["enum"], None]}
    return {"anyOf": [schema, {"type": "null"}]}
