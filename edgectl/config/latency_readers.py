# SPDX-License-Identifier: Apache-2.0
"""Readers of latency, deadline and of how a robot hears a task; tables of their keys."""

from collections.abc import Mapping
from typing import Any

from edgectl.agent.link import protocol
from edgectl.config.check_readers import read_ros_name
from edgectl.config.fields import Fields, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import INVALID, NodeReader, enum_reader, read_bool, read_duration, read_text
from edgectl.config.schema import build_object_schema, describe_as, get_reader_schema
from edgectl.model.check import CheckLocation
from edgectl.model.latency import HeardRule, LatencyRule, StampSource

_HEARD_BY = ("ros_topic", "command")


@describe_as(
    lambda: {"anyOf": [get_reader_schema(read_duration), build_object_schema(DEADLINE_KEYS, ("within",))]}
)
def read_deadline(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A deadline (seconds, whether it is hard): a duration, or a mapping."""
    if not isinstance(node.value, dict):
        seconds = read_duration(node, problems)
        return seconds if seconds is INVALID else (seconds, False)
    values = read_fields(node, problems, DEADLINE_KEYS, required=("within",), what="deadline").values
    return (values["within"], values.get("hard", False)) if "within" in values else INVALID


@describe_as(lambda: {"type": "string", "pattern": f"^{protocol.METRIC_NAME_PATTERN}$"})
def _read_metric_name(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    name = read_text(node, problems)
    if isinstance(name, str) and not protocol.is_metric_name(name):
        hint = "use 1 to 63 of A-Z a-z 0-9 _ . : / -, beginning with a letter or _"
        problems.add(node.mark, ProblemCode.TEXT, f"{name!r} is no name of a metric", hint)
        return INVALID
    return name


@describe_as(lambda: build_object_schema(LATENCY_KEYS) | _require_one("metric", "topic"))
def read_latency(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A metric of the task, or a topic whose messages are stamped."""
    fields = read_fields(node, problems, LATENCY_KEYS, what="latency")
    hint = "write metric: NAME (in ms), or topic: /NAME"
    if not isinstance(node.value, dict) or not _check_one(
        fields, problems, ("metric", "topic"), "latency", hint
    ):
        return INVALID
    for key in ("stamp", "on"):
        if "metric" in fields and key in fields:
            message = f"{key} is for a topic; a metric is what the task writes to $EDGECTL_METRICS"
            problems.add(node.key_mark(key), ProblemCode.CONTRADICTION, message, f"remove {key}")
            return INVALID
    return LatencyRule(**fields.values)


@describe_as(
    lambda: {"anyOf": [{"type": "string"}, build_object_schema(HEARD_KEYS) | _require_one(*_HEARD_BY)]}
)
def read_heard(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A command on the robot, or a mapping with it or with a topic."""
    if isinstance(node.value, str):
        command = read_text(node, problems)
        return command if command is INVALID else HeardRule(command=command)
    fields = read_fields(node, problems, HEARD_KEYS, what="heard")
    hint = "write ros_topic: /NAME, or command: .."
    if not isinstance(node.value, dict) or not _check_one(fields, problems, _HEARD_BY, "heard", hint):
        return INVALID
    return HeardRule(**{_HEARD_FIELDS[key]: value for key, value in fields.values.items()})


def _require_one(*keys: str) -> dict[str, object]:
    return {"oneOf": [{"required": [key]} for key in keys]}


def _check_one(fields: Fields, problems: Problems, keys: tuple[str, str], what: str, hint: str) -> bool:
    """Whether exactly one of the keys is there and was read."""
    stated = [key for key in keys if key in fields]
    if not stated:
        problems.add(fields.node.mark, ProblemCode.MISSING, f"{what} needs {' or '.join(keys)}", hint)
    elif len(stated) > 1:
        message = f"{keys[0]} and {keys[1]} do not go together"
        mark = fields.node.key_mark(keys[1])
        problems.add(mark, ProblemCode.CONTRADICTION, message, f"remove {keys[1]} or {keys[0]}")
    return len(stated) == 1 and stated[0] in fields.values


_HEARD_FIELDS = {"ros_topic": "topic", "command": "command", "within": "within"}
DEADLINE_KEYS: Mapping[str, NodeReader] = {"within": read_duration, "hard": read_bool}
LATENCY_KEYS: Mapping[str, NodeReader] = {
    "metric": _read_metric_name,
    "topic": read_ros_name,
    "stamp": enum_reader(StampSource),
    "on": enum_reader(CheckLocation),
}
HEARD_KEYS: Mapping[str, NodeReader] = {
    "ros_topic": read_ros_name,
    "command": read_text,
    "within": read_duration,
}
