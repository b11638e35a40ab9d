# SPDX-License-Identifier: Apache-2.0
"""Keys of ``events:`` in scenario and experiment files: time or condition, repetition, and the changes."""

from collections.abc import Mapping
from typing import Any

from edgectl.config.fields import list_reader_with_nodes, read_argument_vector, read_fields, record_reader
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import (
    INVALID,
    NodeReader,
    integer_reader,
    quantity_reader,
    read_duration,
    read_name,
    read_text,
)
from edgectl.config.schema import (
    Schema,
    build_object_schema,
    describe_as,
    get_reader_schema,
    limit_quantity_schema,
)
from edgectl.experiments.model.mission_event import CHANGE_KEYS, MODEL_CHANGE_KEYS, RobotProgress
from edgectl.model.resource import TASK_RESOURCES
from edgectl.units import parse_bytes, parse_cores, parse_duration, parse_rate, parse_share

MAX_OCCURRENCES = 100_000
_KIND_WORDS = (*MODEL_CHANGE_KEYS, "event")
_read_names = list_reader_with_nodes(read_name)


@describe_as(lambda: limit_quantity_schema(get_reader_schema(parse_share), above_zero=True, at_most=None))
def _read_fraction(node: Node, problems: Problems) -> Any:  # noqa: ANN401 - INVALID stands for any type
    return quantity_reader(parse_share, above_zero=True, at_most=1.0)(node, problems)


@describe_as(lambda: {"enum": list(_KIND_WORDS)})
def _read_kind(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value in _KIND_WORDS:
        return node.value
    problems.add(
        node.mark,
        ProblemCode.WORD,
        f"unknown kind {node.text}",
        problems.did_you_mean(node.text, _KIND_WORDS, "write one of"),
    )
    return INVALID


LOAD_KEYS: Mapping[str, NodeReader] = {
    "host": read_name,
    "cpu": quantity_reader(parse_cores),
    "memory": quantity_reader(parse_bytes),
}
LINK_CHANGE_KEYS: Mapping[str, NodeReader] = {
    "edge": read_name,
    "robot": read_name,
    "throughput": quantity_reader(parse_rate),
    "delay": quantity_reader(parse_duration),
}
DEMAND_CHANGE_KEYS: Mapping[str, NodeReader] = {
    "task": read_name,
    **{resource.demand_key: quantity_reader(resource.unit.parse) for resource in TASK_RESOURCES},
}
PROGRESS_KEYS: Mapping[str, NodeReader] = {"robot": read_name, "reaches": _read_fraction}
WHEN_KEYS: Mapping[str, NodeReader] = {
    "completed": _read_names,
    "placed": _read_names,
    "progress": record_reader(PROGRESS_KEYS, RobotProgress, "progress", ("robot", "reaches")),
}
SCENARIO_WHEN_KEYS: Mapping[str, NodeReader] = {**WHEN_KEYS, "jobs": _read_names}


def _read_fields_of(table: Mapping[str, NodeReader], what: str, *required: str) -> NodeReader:
    """A mapping that is kept with its places, so that what it names can be checked."""

    @describe_as(lambda: build_object_schema(table, required))
    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        fields = read_fields(node, problems, table, required=required, what=what)
        complete = isinstance(node.value, dict) and all(key in fields.values for key in required)
        return fields if complete else INVALID

    return read


_TIME_KEYS: Mapping[str, NodeReader] = {
    "at": quantity_reader(parse_duration),
    "every": read_duration,
    "times": integer_reader(1, MAX_OCCURRENCES),
    "jitter": quantity_reader(parse_duration),
    "for": read_duration,
    "join": read_name,
    "add": read_name,
}
SCENARIO_EVENT_KEYS: Mapping[str, NodeReader] = {
    **_TIME_KEYS,
    "when": _read_fields_of(SCENARIO_WHEN_KEYS, "when"),
    "load": _read_fields_of(LOAD_KEYS, "a load", "host"),
    "link": _read_fields_of(LINK_CHANGE_KEYS, "a change of a link", "edge", "robot"),
    "lost": read_name,
    "demand": _read_fields_of(DEMAND_CHANGE_KEYS, "a demand", "task"),
}
EXPERIMENT_EVENT_KEYS: Mapping[str, NodeReader] = {
    **_TIME_KEYS,
    "when": _read_fields_of(WHEN_KEYS, "when"),
    "run": read_argument_vector,
    "on": read_name,
    "undo": read_argument_vector,
    "deadline": read_duration,
    "ask": read_text,
    "kind": _read_kind,
}


def build_events_schema(table: Mapping[str, NodeReader]) -> Schema:
    """JSON Schema of ``events:`` with the keys of ``table``: each has a time or a condition, and a change."""
    changes = [{"required": [key]} for key in CHANGE_KEYS if key in table]
    event = build_object_schema(table) | {
        "allOf": [{"oneOf": [{"required": ["at"]}, {"required": ["when"]}]}, {"oneOf": changes}]
    }
    return {"type": "object", "additionalProperties": event}
