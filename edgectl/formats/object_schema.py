# SPDX-License-Identifier: Apache-2.0
"""JSON Schema of a dataclass, from its fields."""

from dataclasses import MISSING
from typing import Any

from edgectl.formats.object_fields import Amounts, Field, Group, is_required
from edgectl.formats.scalar_codecs import Schema, allow_null
from edgectl.model.encoding import DocumentKey

# Endings of keys -> the unit, longest first.
_UNITS = {
    "bytes_per_s": "bytes per second",
    "cores": "cores",
    "bytes": "bytes",
    "_ms": "milliseconds",
    "_s": "seconds",
    "_c": "degrees Celsius",
}


def describe_class(kind: Any, members: list[Field | Group | Amounts], found: Schema) -> Schema:  # noqa: ANN401
    """The schema of a dataclass; ``found`` collects those of the classes inside."""
    properties: Schema = {}
    required: list[str] = []
    conditions: list[Schema] = []
    for member in members:
        if isinstance(member, Group):
            inner = {each.key: describe_field(each, found) for each in member.members}
            needed = [each.key for each in member.members if is_required(each)]
            properties[member.key] = {"type": "object", "properties": inner} | (
                {"required": needed} if needed else {}
            )
            required += [member.key] if needed else []
        elif isinstance(member, Amounts):
            objects, needed = _describe_amounts(member, found)
            properties |= objects
            required += needed if member.place.needed_when is None else []
            conditions += _describe_need(member.place, needed)
        elif member.place.inline:
            conditions.append(member.codec.schema(found))
        else:
            properties[member.key] = describe_field(member, found)
            required += [member.key] if is_required(member) else []
            conditions += _describe_need(member.place, [member.key])
    schema: Schema = {
        "type": "object",
        "description": (kind.__doc__ or "").strip().split("\n")[0],
        "properties": properties,
    }
    return (
        schema | ({"required": required} if required else {}) | ({"allOf": conditions} if conditions else {})
    )


def describe_field(member: Field, found: Schema) -> Schema:
    """The schema of one field, with its unit."""
    schema = member.codec.schema(found)
    if member.default is not MISSING and not member.nullable and not is_required(member):
        schema = allow_null(schema)
    unit = next((words for ending, words in _UNITS.items() if member.key.endswith(ending)), "")
    is_number = schema.get("type") in ("number", "integer", ["number", "null"], ["integer", "null"])
    return schema | {"description": unit} if unit and is_number else schema


def _describe_amounts(member: Amounts, found: Schema) -> tuple[Schema, list[str]]:
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
