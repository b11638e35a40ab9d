"""Placeholders ``{robot}`` and ``{robot_host}``: filled in only where they stand alone, so that ``${robot}``,
``${VAR}`` and ``{a,b}`` reach the shell.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from edgectl.model.inventory import Host
from edgectl.model.ros import RosCheck
from edgectl.model.secret import Secret
from edgectl.model.task import AliveRule, Check, DetectRule, HandoffContract

_PLACEHOLDER = re.compile(r"(?<!\$)\{(robot|robot_host)\}")


def has_placeholder(value: object) -> bool:
    """Whether a field's value contains a placeholder."""
    if isinstance(value, Secret):
        return has_placeholder(value.reveal())
    if isinstance(value, str):
        return _PLACEHOLDER.search(value) is not None
    if isinstance(value, Mapping):
        return any(has_placeholder(inner) for inner in value.values())
    names = (
        *("command", "cmdline", "ros_node", "safe_when", "hold", "release"),
        *("check", "ros", "node", "topic", "name", "service"),
    )
    return any(has_placeholder(getattr(value, name)) for name in names if hasattr(value, name))


def fill_placeholders(values: Mapping[str, Any], robot: Host) -> dict[str, Any]:
    """Fill in the placeholders of ``robot`` in a task's fields."""
    names = {"robot": robot.name, "robot_host": robot.host}
    result = dict(values)
    for key in ("command", "env", "workdir", "ready", "alive", "done_when", "handoff", "detect"):
        if key in result and has_placeholder(result[key]):
            result[key] = _fill_value(result[key], names)
    return result


def _fill_value(value: Any, names: Mapping[str, str]) -> Any:  # noqa: ANN401
    if isinstance(value, Secret):
        return Secret(_fill_value(value.reveal(), names))
    if isinstance(value, str):
        return _PLACEHOLDER.sub(lambda match: names[match[1]], value)
    if isinstance(value, Mapping):
        return {key: _fill_value(inner, names) for key, inner in value.items()}
    if isinstance(value, Check):
        ros = _fill_optional(value.ros, _fill_question, names)
        return replace(value, command=_fill_value(value.command, names), ros=ros)
    if isinstance(value, AliveRule):
        return replace(value, check=_fill_value(value.check, names))
    if isinstance(value, DetectRule):
        escaped = {key: re.escape(name) for key, name in names.items()}
        return DetectRule(
            cmdline=_fill_optional(value.cmdline, _fill_value, escaped),
            ros_node=_fill_optional(value.ros_node, _fill_value, names),
        )
    return _fill_hooks(value, names)


def _fill_question(value: RosCheck, names: Mapping[str, str]) -> RosCheck:
    def fill(text: str, names: Mapping[str, str]) -> str:
        return str(_fill_value(text, names))

    topic = value.topic and replace(value.topic, name=fill(value.topic.name, names))
    node, service = (_fill_optional(text, fill, names) for text in (value.node, value.service))
    return replace(value, node=node, topic=topic, service=service)


def _fill_hooks(handoff: HandoffContract, names: Mapping[str, str]) -> HandoffContract:
    hooks = {key: getattr(handoff, key) for key in ("safe_when", "hold", "release")}
    return replace(handoff, **{key: _fill_optional(hook, _fill_value, names) for key, hook in hooks.items()})


def _fill_optional(
    value: Any,  # noqa: ANN401
    fill: Callable[[Any, Mapping[str, str]], Any],
    names: Mapping[str, str],
) -> Any:  # noqa: ANN401
    return None if value is None else fill(value, names)
