# SPDX-License-Identifier: Apache-2.0
"""Placeholders ``{robot}`` and ``{robot_host}``: filled in only where they stand alone, so that ``${robot}``,
``${VAR}`` and ``{a,b}`` reach the shell.
"""

import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from enum import StrEnum
from typing import Any

from edgectl.model.inventory import Host
from edgectl.model.resource import ResourceMap
from edgectl.model.secret import Secret
from edgectl.model.task import DetectRule

# Keys of a task whose values may contain placeholders.
PLACEHOLDER_KEYS = (
    *("command", "env", "workdir", "ready", "alive", "done_when"),
    *("handoff", "detect", "latency", "heard", "standby", "state", "image"),
)
_PLACEHOLDER = re.compile(r"(?<!\$)\{(robot|robot_host)\}")


def has_placeholder(value: object) -> bool:
    """Whether a field's value contains a placeholder."""
    if isinstance(value, Secret):
        return has_placeholder(value.reveal())
    if isinstance(value, str):
        return _PLACEHOLDER.search(value) is not None
    if isinstance(value, tuple):
        return any(has_placeholder(inner) for inner in value)
    if isinstance(value, Mapping):
        return any(has_placeholder(inner) for inner in value.values())
    if is_dataclass(value):
        return any(has_placeholder(getattr(value, item.name)) for item in fields(value))
    return False


def fill_placeholders(values: Mapping[str, Any], robot: Host) -> dict[str, Any]:
    """Fill in the placeholders of ``robot`` in a task's fields."""
    names = {"robot": robot.name, "robot_host": robot.host}
    result = dict(values)
    for key in PLACEHOLDER_KEYS:
        if key in result and has_placeholder(result[key]):
            result[key] = _fill_value(result[key], names)
    return result


def _fill_value(value: Any, names: Mapping[str, str]) -> Any:  # noqa: ANN401
    if isinstance(value, Secret):
        return Secret(_fill_value(value.reveal(), names))
    if isinstance(value, str) and not isinstance(value, StrEnum):
        return _PLACEHOLDER.sub(lambda match: names[match[1]], value)
    if isinstance(value, tuple):
        return tuple(_fill_value(inner, names) for inner in value)
    if isinstance(value, Mapping) and not isinstance(value, ResourceMap):
        return {key: _fill_value(inner, names) for key, inner in value.items()}
    if isinstance(value, DetectRule):
        escaped = {key: re.escape(name) for key, name in names.items()}
        return DetectRule(
            cmdline=_fill_value(value.cmdline, escaped), ros_node=_fill_value(value.ros_node, names)
        )
    if is_dataclass(value) and not isinstance(value, type):
        return replace(
            value, **{item.name: _fill_value(getattr(value, item.name), names) for item in fields(value)}
        )
    return value
