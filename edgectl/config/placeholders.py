"""``{robot}`` and ``{robot_host}``: filled in where they stand alone, so that ``${robot}``, ``${VAR}`` and ``{a,b}`` reach the shell."""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from edgectl.model.inventory import Host
from edgectl.model.secret import Secret
from edgectl.model.task import Check, Detect, Handoff

_PLACEHOLDER = re.compile(r"(?<!\$)\{(robot|robot_host)\}")


def has_placeholder(value: object) -> bool:
    """Whether any text in a field's value would be filled in."""
    if isinstance(value, Secret):
        return has_placeholder(value.reveal())
    if isinstance(value, str):
        return _PLACEHOLDER.search(value) is not None
    if isinstance(value, Mapping):
        return any(has_placeholder(inner) for inner in value.values())
    names = ("command", "cmdline", "ros_node", "safe_when", "hold", "release")
    return any(has_placeholder(getattr(value, name)) for name in names if hasattr(value, name))


def filled(values: Mapping[str, Any], robot: Host) -> dict[str, Any]:
    """A task's fields with the placeholders of ``robot`` filled in."""
    names = {"robot": robot.name, "robot_host": robot.host}
    result = dict(values)
    for key in ("command", "env", "workdir", "ready", "done_when", "handoff", "detect"):
        if key in result and has_placeholder(result[key]):
            result[key] = _fill(result[key], names)
    return result


def _fill(value: Any, names: Mapping[str, str]) -> Any:  # noqa: ANN401
    if isinstance(value, Secret):
        return Secret(_fill(value.reveal(), names))
    if isinstance(value, str):
        return _PLACEHOLDER.sub(lambda match: names[match[1]], value)
    if isinstance(value, Mapping):
        return {key: _fill(inner, names) for key, inner in value.items()}
    if isinstance(value, Check):
        return replace(value, command=_fill(value.command, names))
    if isinstance(value, Detect):
        escaped = {key: re.escape(name) for key, name in names.items()}
        return Detect(cmdline=_maybe(value.cmdline, _fill, escaped), ros_node=_maybe(value.ros_node, _fill, names))
    return _fill_hooks(value, names)


def _fill_hooks(handoff: Handoff, names: Mapping[str, str]) -> Handoff:
    hooks = {key: getattr(handoff, key) for key in ("safe_when", "hold", "release")}
    return replace(handoff, **{key: _maybe(hook, _fill, names) for key, hook in hooks.items()})


def _maybe(value: Any, fill: Callable[[Any, Mapping[str, str]], Any], names: Mapping[str, str]) -> Any:  # noqa: ANN401
    return None if value is None else fill(value, names)
