# SPDX-License-Identifier: Apache-2.0
"""Readers of checks and hooks: commands, questions to the ROS graph; tables of their keys."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from edgectl.config.fields import Fields, read_fields, record_reader
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.scalars import (
    INVALID,
    NodeReader,
    enum_reader,
    read_duration,
    read_name,
    read_text,
)
from edgectl.config.schema import (
    Schema,
    build_object_schema,
    describe_as,
    describe_reader,
    get_reader_schema,
)
from edgectl.model.check import AliveRule, Check, CheckLocation
from edgectl.model.ros import RosCheck, RosTopic


def check_reader(where: CheckLocation) -> NodeReader:
    """A check: its command alone, or a mapping. ``where`` it runs unless it says so."""

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if isinstance(node.value, str):
            command = read_text(node, problems)
            return command if command is INVALID else Check(command=command, on=where)
        fields = read_fields(node, problems, CHECK_KEYS, what="a check")
        return _build_check(fields, problems, where)

    return describe_reader(
        read, lambda: {"anyOf": [get_reader_schema(read_text), _describe_check(CHECK_KEYS)]}
    )


def hook_reader(where: CheckLocation) -> NodeReader:
    """A command that acts: as a check, without questions to the ROS graph."""
    mapping = record_reader(HOOK_KEYS, Check, "a hook", ("command",))

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if isinstance(node.value, str):
            command = read_text(node, problems)
            return command if command is INVALID else Check(command=command, on=where)
        hook = mapping(node, problems)
        stated = isinstance(node.value, dict) and "on" in node.value
        return hook if hook is INVALID or stated else replace(hook, on=where)

    return describe_reader(
        read, lambda: {"anyOf": [get_reader_schema(read_text), get_reader_schema(mapping)]}
    )


def _describe_check(keys: Mapping[str, NodeReader]) -> Schema:
    asks = [{"required": [key]} for key in ("command", *_ROS_QUESTIONS)]
    return build_object_schema(keys) | {"anyOf": asks}


def _build_check(fields: Fields, problems: Problems, where: CheckLocation) -> Any:  # noqa: ANN401
    """A command, or questions to the ROS graph; not both, and not neither."""
    values, node = fields.values, fields.node
    if not isinstance(node.value, dict):
        return INVALID
    asked = [key for key in _ROS_QUESTIONS if key in fields]
    if "command" not in fields and not asked:
        message = "a check needs command, or a question to the ROS graph"
        problems.add(
            node.mark, ProblemCode.MISSING, message, f"add command: .., or one of {', '.join(_ROS_QUESTIONS)}"
        )
        return INVALID
    if "command" in fields and asked:
        problems.add(
            node.key_mark(asked[0]),
            ProblemCode.CONTRADICTION,
            f"a check asks by command or by {asked[0]}",
            f"remove command or {asked[0]}",
        )
        return INVALID
    if "ros_lifecycle" in fields and "ros_node" not in fields:
        problems.add(
            node.key_mark("ros_lifecycle"),
            ProblemCode.MISSING,
            "ros_lifecycle is the state of a node, and none is named",
            "add ros_node: /NAME",
        )
        return INVALID
    if not all(key in values for key in ("command" if not asked else asked[0], *asked)):
        return INVALID
    ros = RosCheck(**{_ROS_QUESTIONS[key]: values[key] for key in asked}) if asked else None
    stated = {key: values[key] for key in ("command", "timeout") if key in values}
    return Check(**stated, on=values.get("on", where), ros=ros)


@describe_as(lambda: {"anyOf": [{"type": "string"}, _describe_check(ALIVE_KEYS)]})
def read_alive(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """The question that decides whether a running task is alive: a command, or a mapping."""
    if isinstance(node.value, str):
        command = read_text(node, problems)
        return command if command is INVALID else AliveRule(check=Check(command=command))
    fields = read_fields(node, problems, ALIVE_KEYS, what="alive")
    check = _build_check(fields, problems, CheckLocation.HOST)
    if check is INVALID:
        return INVALID
    after = {"after": fields.values["after"]} if "after" in fields.values else {}
    return AliveRule(check=check, **after)


@describe_as(lambda: {"type": "string", "pattern": r"^[A-Za-z0-9_/~{}.-]+$"})
def read_ros_name(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A name in the ROS graph, from its root; a placeholder may be part of it."""
    name = read_text(node, problems)
    if not isinstance(name, str):
        return name
    if not _ROS_NAME.fullmatch(name):
        hint = "write a name such as /slam, or /{robot}/slam"
        problems.add(node.mark, ProblemCode.TEXT, f"{name!r} is no name in the ROS graph", hint)
        return INVALID
    return name if name.startswith("/") else f"/{name}"


@describe_as(
    lambda: {"anyOf": [get_reader_schema(read_ros_name), build_object_schema(ROS_TOPIC_KEYS, ("name",))]}
)
def _read_ros_topic(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    """A topic: its name, or a mapping with the time within which a message must come."""
    if isinstance(node.value, dict):
        return record_reader(ROS_TOPIC_KEYS, RosTopic, "a topic", ("name",))(node, problems)
    name = read_ros_name(node, problems)
    return name if name is INVALID else RosTopic(name=name)


# Keys that ask the ROS graph, and the field of `RosCheck` that each fills.
_ROS_QUESTIONS = {
    "ros_node": "node",
    "ros_topic": "topic",
    "ros_service": "service",
    "ros_lifecycle": "lifecycle",
}
_ROS_NAME = re.compile(r"/?[A-Za-z0-9_{][A-Za-z0-9_/{}.-]*")
ROS_TOPIC_KEYS: Mapping[str, NodeReader] = {"name": read_ros_name, "within": read_duration}
HOOK_KEYS: Mapping[str, NodeReader] = {
    "command": read_text,
    "on": enum_reader(CheckLocation),
    "timeout": read_duration,
}
CHECK_KEYS: Mapping[str, NodeReader] = {
    **HOOK_KEYS,
    "ros_node": read_ros_name,
    "ros_topic": _read_ros_topic,
    "ros_service": read_ros_name,
    "ros_lifecycle": read_name,
}
ALIVE_KEYS: Mapping[str, NodeReader] = {
    **{key: read for key, read in CHECK_KEYS.items() if key != "on"},
    "after": read_duration,
}
