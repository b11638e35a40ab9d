# SPDX-License-Identifier: Apache-2.0
"""JSON Schemas of the YAML files, out of the readers that read them."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

from edgectl.model.resource import RESOURCES
from edgectl.units import DURATION_PATTERN, SHARE_PATTERN, parse_duration, parse_share

Schema = dict[str, Any]
Reader = TypeVar("Reader", bound=Callable[..., Any])
_SCHEMAS: "WeakKeyDictionary[Callable[..., Any], Callable[[], Schema]]" = WeakKeyDictionary()


def describe_reader(read: Reader, schema: Callable[[], Schema]) -> Reader:
    """Attach a schema to a reader of nodes, or to a parser of quantities.

    It is built only when it is asked for.
    """
    _SCHEMAS[read] = schema
    return read


def describe_as(schema: Callable[[], Schema]) -> Callable[[Reader], Reader]:
    """The same as a decorator."""
    return lambda read: describe_reader(read, schema)


def get_reader_schema(read: Callable[..., Any]) -> Schema:
    """The schema of what ``read`` accepts; it allows everything where none is attached."""
    schema = _SCHEMAS.get(read)
    return schema() if schema is not None else {}


def build_object_schema(
    table: Mapping[str, Callable[..., Any]], required: Iterable[str] = (), **properties: Schema
) -> Schema:
    """A mapping with the keys of a table of readers and no others.

    ``properties`` replaces the schemas of some.
    """
    schemas = {key: properties.get(key, get_reader_schema(read)) for key, read in table.items()}
    schema: Schema = {"type": "object", "properties": schemas, "additionalProperties": False}
    return schema | ({"required": list(required)} if required else {})


def build_mapping_schema(key_pattern: str, value: Schema) -> Schema:
    """A mapping of free keys of one form."""
    return {
        "type": "object",
        "propertyNames": {"pattern": f"^(?:{key_pattern})$"},
        "additionalProperties": value,
    }


def build_quantity_schema(pattern: str, *, bare_numbers: bool = True) -> Schema:
    """Text with a unit and, for most quantities, a bare number."""
    text = {"type": "string", "pattern": rf"^\s*(?:{pattern})\s*$"}
    return {"anyOf": [{"type": "number", "minimum": 0}, text]} if bare_numbers else text


def limit_quantity_schema(schema: Schema, *, above_zero: bool, at_most: float | None) -> Schema:
    """The schema with the range of numbers narrowed; of text, as far as a pattern can tell."""
    if "anyOf" in schema:
        inner = [
            limit_quantity_schema(each, above_zero=above_zero, at_most=at_most) for each in schema["anyOf"]
        ]
        return schema | {"anyOf": inner}
    if schema.get("type") == "string":
        not_zero = schema["pattern"].replace("^", "^(?=[^eE]*[1-9])", 1)
        return schema | {"pattern": not_zero} if above_zero else schema
    limited = schema | ({"maximum": at_most} if at_most is not None else {})
    if above_zero:
        limited.pop("minimum", None)
        limited["exclusiveMinimum"] = 0
    return limited


def build_file_schema(title: str, schema: Schema) -> Schema:
    """The schema of a whole file."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "description": f"edgectl: {title}. Written by edgectl schema.",
        **schema,
    }


for _parse, _pattern in (
    *((resource.unit.parse, resource.unit.pattern) for resource in RESOURCES),
    (parse_duration, DURATION_PATTERN),
):
    describe_reader(_parse, lambda _pattern=_pattern: build_quantity_schema(_pattern))  # type: ignore[misc]
describe_reader(parse_share, lambda: build_quantity_schema(SHARE_PATTERN, bare_numbers=False))
