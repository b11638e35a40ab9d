# SPDX-License-Identifier: Apache-2.0
"""Readers of the values of a task: needs, rules for hosts, stop, handoff; tables of their keys."""

import re
import shlex
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from edgectl.config.check_readers import check_reader, hook_reader
from edgectl.config.fields import (
    list_reader_with_nodes,
    read_fields,
    read_labels,
    record_reader,
)
from edgectl.config.node import Node, value_from_node
from edgectl.config.problems import Mark, ProblemCode, Problems
from edgectl.config.scalars import (
    INVALID,
    NodeReader,
    enum_reader,
    integer_reader,
    quantity_reader,
    read_duration,
    read_name,
    read_text,
    report_wrong_type,
)
from edgectl.config.schema import (
    Schema,
    build_object_schema,
    describe_as,
    get_reader_schema,
)
from edgectl.config.weights import parse_weights
from edgectl.model.check import CheckLocation
from edgectl.model.policy import WEIGHT_PRESETS
from edgectl.model.resource import TERMS
from edgectl.model.task import HandoffOrder, Need, NeedCondition, NeedRestart, StopRule, UnreachablePolicy
from edgectl.units import QuantityError, parse_bytes, parse_cores, parse_duration

_NAME_LIST: Schema = {"type": "array", "items": {"type": "string", "pattern": r"\S"}}
_SIGNALS = ("TERM", "INT", "HUP", "QUIT", "KILL", "USR1", "USR2")


@describe_as(lambda: {"anyOf": [get_reader_schema(read_name), build_object_schema(NEED_KEYS, ("task",))]})
def read_need(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A predecessor: its name, or a mapping with the state to wait for."""
    if isinstance(node.value, dict):
        return record_reader(NEED_KEYS, Need, "a need", ("task",))(node, problems)
    task = read_name(node, problems)
    return task if task is INVALID else Need(task=task)


@describe_as(lambda: {"enum": list(_SIGNALS)})
def _read_signal(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value in _SIGNALS:
        return node.value
    problems.add(
        node.mark,
        ProblemCode.WORD,
        f"unknown signal {node.text!r}",
        problems.did_you_mean(node.text.upper().removeprefix("SIG"), _SIGNALS),
    )
    return INVALID


@describe_as(lambda: {"anyOf": [{"const": "ros"}, build_object_schema(STOP_KEYS)]})
def read_stop(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The way to stop a task: the word ``ros``, or a mapping."""
    if node.value == "ros":
        return StopRule(signal="INT", preset="ros")
    if isinstance(node.value, dict):
        stop = record_reader(STOP_KEYS, StopRule, "stop")(node, problems)
        ros = stop is not INVALID and stop.preset == "ros" and "signal" not in node.value
        return replace(stop, signal="INT") if ros else stop
    problems.add(
        node.mark,
        ProblemCode.WORD,
        f"unknown way to stop: {node.text or '?'}",
        "write ros, or {signal: TERM, grace: 20s}",
    )
    return INVALID


@describe_as(lambda: {"const": "ros"})
def _read_stop_preset(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value == "ros":
        return "ros"
    problems.add(node.mark, ProblemCode.WORD, f"unknown preset {node.text!r}", "write ros, or remove preset")
    return INVALID


@describe_as(lambda: {"type": "string", "format": "regex", "pattern": r"\S"})
def _read_regex(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    value = read_text(node, problems)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", FutureWarning
            )  # Python's own plans for "[[" are nothing to whoever runs edgectl
            re.compile(value) if isinstance(value, str) else None
    except (re.error, OverflowError, RecursionError) as error:
        hint = f"escape it to mean the characters themselves: '{re.escape(str(value))}'"
        problems.add(node.mark, ProblemCode.REGEX, f"not a regular expression: {error}", hint)
        return INVALID
    return value


@describe_as(
    lambda: {
        "anyOf": [{"enum": list(UnreachablePolicy)}, build_object_schema(ON_UNREACHABLE_KEYS, ("policy",))]
    }
)
def read_on_unreachable(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The policy for an unreachable host: a word, or a mapping."""
    if isinstance(node.value, dict):
        fields = read_fields(node, problems, ON_UNREACHABLE_KEYS, required=("policy",), what="on_unreachable")
        policy = fields.values.get("policy", INVALID)
        return INVALID if policy is INVALID else (policy, fields.values.get("after"))
    policy = enum_reader(UnreachablePolicy)(node, problems)
    return policy if policy is INVALID else (policy, None)


@describe_as(lambda: {"anyOf": [{"const": "all"}, _NAME_LIST]})
def read_robots(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The word ``all``, or names."""
    return "all" if node.value == "all" else list_reader_with_nodes(read_name)(node, problems)


@describe_as(lambda: {"anyOf": [{"const": "robot"}, _NAME_LIST | {"minItems": 1}]})
def read_for_each(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The word ``robot``, or names."""
    if isinstance(node.value, list) and node.value:
        return list_reader_with_nodes(read_name)(node, problems)
    if node.value == "robot":
        return "all"
    return report_wrong_type(
        node, problems, "must be the word robot, or a list of robots", "write for_each: robot"
    )


@describe_as(lambda: {"type": "number", "minimum": -1e9, "maximum": 1e9})
def read_priority(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A number between -1e9 and 1e9."""
    value = node.value
    if isinstance(value, bool) or not isinstance(value, int | float):
        return report_wrong_type(node, problems, "must be a number", "write 10, or -1; high goes first")
    if not abs(value) <= 1e9:
        problems.add(
            node.mark,
            ProblemCode.QUANTITY,
            f"must be a finite number, not {node.text}",
            "write a number between -1e9 and 1e9",
        )
        return INVALID
    return float(value)


@describe_as(lambda: build_object_schema(HOST_RULES_KEYS))
def read_host_rules(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The rules for hosts of a task."""
    return read_fields(node, problems, HOST_RULES_KEYS, what="hosts")


def _describe_weights() -> Schema:
    weight: Schema = {"type": "number", "minimum": 0}
    above_zero = [{"required": [term], "properties": {term: {"exclusiveMinimum": 0}}} for term in TERMS]
    mapping = {
        "type": "object",
        "properties": dict.fromkeys(TERMS, weight),
        "additionalProperties": False,
        "anyOf": above_zero,
    }
    return {"anyOf": [{"enum": list(WEIGHT_PRESETS)}, {"type": "string", "pattern": "="}, mapping]}


@describe_as(_describe_weights)
def read_weights(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A preset, text or a mapping of weights."""
    try:
        return parse_weights(value_from_node(node))
    except QuantityError as error:
        mark = _find_weight_mark(node, error.message)
        problems.add(mark, ProblemCode.QUANTITY, error.message, error.hint)
        return INVALID


def _find_weight_mark(node: Node, message: str) -> Mark:
    """Where the weight stands that ``message`` names."""
    for key, inner in node.value.items() if isinstance(node.value, dict) else ():
        if message == f"unknown weight {key!r}":
            return node.key_mark(key)
        if message.startswith(f"weight {key} "):
            return inner.mark
    return node.mark


@describe_as(
    lambda: {"anyOf": [{"const": "unlimited"}, {"type": "integer", "minimum": 0, "maximum": 1_000_000}]}
)
def read_max_moves(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A whole number, or the word ``unlimited`` (None)."""
    return None if node.value == "unlimited" else integer_reader(0, 1_000_000)(node, problems)


NEED_KEYS: Mapping[str, NodeReader] = {
    "task": read_name,
    "until": enum_reader(NeedCondition),
    "restart": enum_reader(NeedRestart),
}


@describe_as(lambda: {"type": "string", "pattern": r"^[^\0]*[^\s\0][^\0]*$"})
def read_command(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """One string for a shell; of a list of words the hint is the string."""
    inner = [each.value for each in node.value] if isinstance(node.value, list) else []
    words = [word for word in inner if isinstance(word, str)]
    if words and words == inner:
        hint = f"write command: {shlex.join(words)}"
        return report_wrong_type(node, problems, "must be one string, which a shell runs", hint)
    return read_text(node, problems)


HOST_RULES_KEYS: Mapping[str, NodeReader] = {
    "only": list_reader_with_nodes(read_name),
    "never": list_reader_with_nodes(read_name),
    "labels": read_labels,
    "pin": read_name,
}


DETECT_KEYS: Mapping[str, NodeReader] = {"cmdline": _read_regex, "ros_node": read_text}


STOP_KEYS: Mapping[str, NodeReader] = {
    "signal": _read_signal,
    "grace": quantity_reader(parse_duration),
    "preset": _read_stop_preset,
}


HANDOFF_KEYS: Mapping[str, NodeReader] = {
    "order": enum_reader(HandoffOrder),
    "safe_when": check_reader(CheckLocation.ROBOT),
    "hold": hook_reader(CheckLocation.ROBOT),
    "release": hook_reader(CheckLocation.ROBOT),
    "timeout": read_duration,
}


TASK_LIMITS_KEYS: Mapping[str, NodeReader] = {
    "cpu": quantity_reader(parse_cores, above_zero=True),
    "memory": quantity_reader(parse_bytes, above_zero=True),
}


LOG_KEYS: Mapping[str, NodeReader] = {
    "max_size": quantity_reader(parse_bytes, above_zero=True),
    "files": integer_reader(1, 100),
}


ON_UNREACHABLE_KEYS: Mapping[str, NodeReader] = {
    "policy": enum_reader(UnreachablePolicy),
    "after": read_duration,
}
