"""``on_event`` of an inventory: programs that are told of events."""

import re
from collections.abc import Mapping
from typing import Any

from edgectl.config.fields import (
    list_reader,
    mapping_reader,
    read_argument_vector,
    read_fields,
)
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import INVALID, NodeReader, enum_reader, quantity_reader, read_name
from edgectl.config.schema import Schema, build_object_schema, describe_as, get_reader_schema
from edgectl.model.event import EventHook, EventKind
from edgectl.units import parse_duration

_ALL_KINDS, _OPTION_NAME = "all", re.compile(r"[a-z][a-z0-9_]{0,62}")
_LONGEST_TIMEOUT_S, _LONGEST_PAUSE_S = 60.0, 3600.0


@describe_as(
    lambda: {"anyOf": [{"const": _ALL_KINDS}, get_reader_schema(list_reader(enum_reader(EventKind)))]}
)
def _read_kinds(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    if node.value == _ALL_KINDS:
        return tuple(EventKind)
    return list_reader(enum_reader(EventKind))(node, problems)


HOOK_KEYS: Mapping[str, NodeReader] = {
    "command": read_argument_vector,
    "notifier": read_name,
    "options": mapping_reader(_OPTION_NAME, "an option"),
    "kinds": _read_kinds,
    "timeout": quantity_reader(parse_duration, above_zero=True, at_most=_LONGEST_TIMEOUT_S),
    "every": quantity_reader(parse_duration, at_most=_LONGEST_PAUSE_S),
}
_EXAMPLE = 'write command: ["python3", "notify.py"]'


def _describe_hook() -> Schema:
    return build_object_schema(HOOK_KEYS) | {"oneOf": [{"required": ["command"]}, {"required": ["notifier"]}]}


@describe_as(_describe_hook)
def _read_hook(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    fields = read_fields(node, problems, HOOK_KEYS, what="an entry of on_event")
    if not isinstance(node.value, dict):
        return INVALID
    if ("command" in fields) == ("notifier" in fields):
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION if "command" in fields else ProblemCode.MISSING,
            "an entry of on_event needs either command or notifier",
            "remove one of the two" if "command" in fields else _EXAMPLE,
        )
        return INVALID
    if "options" in fields and "command" in fields:
        problems.add(
            fields.at("options").mark,
            ProblemCode.CONTRADICTION,
            "options are for a notifier, not for a command",
            "write them into the command",
        )
    return EventHook(**fields.values)


read_event_hooks = list_reader(_read_hook)
