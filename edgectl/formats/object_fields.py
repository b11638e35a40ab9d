# SPDX-License-Identifier: Apache-2.0
"""Fields of a dataclass in a JSON object: single, grouped below a key, or amounts by resource."""

from collections.abc import Mapping
from dataclasses import MISSING
from typing import Any

from edgectl.dataclass import dataclass
from edgectl.formats.document import Document, Faults, FieldPath
from edgectl.formats.scalar_codecs import Codec, is_type, report_absent
from edgectl.model.encoding import DocumentKey
from edgectl.model.resource import RESOURCES, Resource, ResourceMap


@dataclass(frozen=True, slots=True)
class Amounts:
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
        return not (resource.optional or may_be_unknown)


@dataclass(frozen=True, slots=True)
class Field:
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
class Group:
    """Fields of a class that stand in an object of their own under ``key``."""

    key: str
    members: tuple[Field, ...]


def is_required(member: Field) -> bool:
    """Whether a field must be there, whatever the others are."""
    return member.place.required or (member.default is MISSING and not member.nullable)


def _is_needed(place: DocumentKey, values: Mapping[str, Any]) -> bool:
    """Whether another field asks for this one; one that is wrong itself may do so."""
    if place.needed_when is None:
        return False
    other, word = place.needed_when
    return values.get(other) in (None, word)


def encode_member(member: Field | Group | Amounts, value: Any, document: Document) -> None:  # noqa: ANN401
    """Add a field of ``value`` to ``document``, unless it has its default."""
    if isinstance(member, Group):
        if inner := _encode_fields(value, member.members):
            document[member.key] = inner
    elif isinstance(member, Amounts):
        _encode_amounts(member, value, document)
    elif member.place.inline:
        document |= member.codec.encode(getattr(value, member.name))
    else:
        _encode_field(value, member, document)


def _encode_amounts(member: Amounts, value: object, document: Document) -> None:
    amounts = getattr(value, member.name)
    for resource in member.resources:
        amount = amounts.get(resource.name)
        if amount is None or (not amount and resource.optional):
            continue
        unit = resource.unit.name
        document[resource.name] = {
            f"{part}_{unit}": codec.encode(amount if member.value_type is None else getattr(amount, part))
            for part, codec in member.parts
        }


def _encode_fields(value: object, members: tuple[Field, ...]) -> Document:
    document: Document = {}
    for member in members:
        _encode_field(value, member, document)
    return document


def _encode_field(value: object, member: Field, document: Document) -> None:
    inner = getattr(value, member.name)
    if member.place.always or (inner is not member.default and inner != member.default):
        document[member.key] = member.codec.encode(inner)


def decode_member(
    member: Field | Group | Amounts,
    raw: Any,  # noqa: ANN401
    path: FieldPath,
    faults: Faults,
    values: dict[str, Any],
) -> None:
    """Read a field of the object ``raw`` into ``values``; what is wrong is added to ``faults``."""
    if isinstance(member, Group):
        _decode_group(member, raw, path, faults, values)
    elif isinstance(member, Amounts):
        _decode_amounts(member, raw, path, faults, values)
    else:
        _decode_field(member, raw, path, faults, values)


def _decode_amounts(
    member: Amounts,
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
                report_absent(resource.name, raw, path, faults)
        elif is_type(inner, dict, (*path, resource.name), faults):
            decoded[resource.name] = _decode_parts(member, resource, inner, (*path, resource.name), faults)
    values[member.name] = member.kind(decoded) if issubclass(member.kind, ResourceMap) else decoded


def _decode_parts(
    member: Amounts, resource: Resource, raw: Mapping[str, Any], path: FieldPath, faults: Faults
) -> Any:  # noqa: ANN401
    before, found = len(faults), {}
    for part, codec in member.parts:
        key = f"{part}_{resource.unit.name}"
        if raw.get(key) is None:
            report_absent(key, raw, path, faults)
        else:
            found[part] = codec.decode(raw[key], (*path, key), faults)
    if len(faults) > before:
        return None
    return found[member.parts[0][0]] if member.value_type is None else member.value_type(**found)


def _decode_group(member: Group, raw: Any, path: FieldPath, faults: Faults, values: dict[str, Any]) -> None:  # noqa: ANN401
    inner = raw.get(member.key)
    if inner is None:
        if any(is_required(each) for each in member.members):
            report_absent(member.key, raw, path, faults)
    elif is_type(inner, dict, (*path, member.key), faults):
        for each in member.members:
            _decode_field(each, inner, (*path, member.key), faults, values)


def _decode_field(member: Field, raw: Any, path: FieldPath, faults: Faults, values: dict[str, Any]) -> None:  # noqa: ANN401
    if member.place.inline:
        values[member.name] = member.codec.decode(raw, path, faults)
        return
    found = raw.get(member.key)
    if found is not None:
        values[member.name] = member.codec.decode(found, (*path, member.key), faults)
    elif is_required(member) or _is_needed(member.place, values):
        report_absent(member.key, raw, path, faults)
    elif member.default is MISSING or (member.nullable and member.key in raw):
        values[member.name] = None
