"""Rules between the keys of a task, and between a task and the inventory."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from edgectl.config.fields import Fields
from edgectl.config.node import Node
from edgectl.config.placeholders import has_placeholder
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.task_file import EXCLUSIVE_KEYS, TaskDraft, TaskTemplate
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.resource import RESOURCES
from edgectl.model.task import (
    Check,
    CheckLocation,
    Demand,
    HostRules,
    OnboardRule,
    RestartPolicy,
    TaskKind,
    UnreachablePolicy,
)

_TRAILING_AMPERSAND = re.compile(r"(?<![&>|\\])&\s*$")


@dataclass(frozen=True, slots=True)
class FleetIndex:
    """What tasks may refer to, looked up once: hosts, the robots' names, and the values of every label."""

    hosts: Mapping[str, Host]
    robots: tuple[str, ...]
    labels: Mapping[str, frozenset[str]]


def index_fleet(inventory: Inventory) -> FleetIndex:
    """The names of an inventory."""
    labels: dict[str, set[str]] = {}
    for host in inventory.hosts.values():
        for key, value in host.labels.items():
            labels.setdefault(key, set()).add(value)
    robots = tuple(robot.name for robot in inventory.robots)
    return FleetIndex(inventory.hosts, robots, {key: frozenset(labels[key]) for key in sorted(labels)})


def check_template(template: TaskTemplate, problems: Problems) -> None:
    """Contradictions within one entry."""
    fields = template.fields
    _check_exclusive_keys(fields, problems)
    if fields.values.get("managed", True):
        _check_managed(template, problems)
    else:
        _check_unmanaged(template, problems)


def _check_exclusive_keys(fields: Fields, problems: Problems) -> None:
    for one, other in EXCLUSIVE_KEYS:
        if one in fields and other in fields:
            message = f"{one} and {other} do not go together"
            problems.add(
                fields.node.key_mark(other), ProblemCode.CONTRADICTION, message, f"remove {other} or {one}"
            )


def _check_managed(template: TaskTemplate, problems: Problems) -> None:
    fields = template.fields
    if "command" not in fields and isinstance(fields.node.value, dict):
        hint = "add command: .., or managed: false with detect:"
        problems.add(template.named_at, ProblemCode.MISSING, f"task {template.name} needs command", hint)
    if "detect" in fields:
        message = "detect finds tasks that edgectl does not start, and this one it does"
        problems.add(
            fields.node.key_mark("detect"),
            ProblemCode.CONTRADICTION,
            message,
            "remove detect, or write managed: false and remove command",
        )
    if fields.values.get("kind") is TaskKind.JOB and fields.values.get("restart") is RestartPolicy.ALWAYS:
        message = "a job that is always restarted never completes"
        problems.add(
            fields.node.key_mark("restart"), ProblemCode.CONTRADICTION, message, "write restart: on-failure"
        )
    _check_self_fence(fields, problems)
    _check_foreground(fields, problems)


def _check_foreground(fields: Fields, problems: Problems) -> None:
    """A command that goes to the background has ended for its supervisor, which then ends what it left."""
    command = fields.values.get("command")
    if isinstance(command, str) and _TRAILING_AMPERSAND.search(command):
        problems.add(
            fields.at("command").mark,
            ProblemCode.BACKGROUND,
            "the command goes to the background, so the task ends at once",
            "drop the & at its end",
            warning=True,
        )


def _check_self_fence(fields: Fields, problems: Problems) -> None:
    """Nothing starts a task elsewhere while its old copy may still run."""
    policy, _ = fields.values.get("on_unreachable", (None, None))
    if policy is UnreachablePolicy.REPLACE and "self_fence" not in fields:
        message = (
            "on_unreachable: replace needs self_fence: a task on an unreachable host is replaced only "
            "if it stops itself there"
        )
        hint = (
            "add self_fence: 5m (several times the pause between two applies), "
            "or write hold and declare a host powered off by hand: edgectl fence HOST"
        )
        problems.add(fields.node.key_mark("on_unreachable"), ProblemCode.CONTRADICTION, message, hint)


def _check_unmanaged(template: TaskTemplate, problems: Problems) -> None:
    fields = template.fields
    if "command" in fields:
        message = "a task with managed: false is never started, so it has no command"
        problems.add(
            fields.node.key_mark("command"),
            ProblemCode.CONTRADICTION,
            message,
            "remove command, or remove managed: false",
        )
    if "detect" not in fields:
        message = f"task {template.name} has managed: false, so it needs detect"
        problems.add(
            template.named_at,
            ProblemCode.MISSING,
            message,
            "add detect: {cmdline: 'a regular expression'} or {ros_node: /name}",
        )
    stated = fields.at("detect").value if "detect" in fields else None
    if isinstance(stated, dict) and ("cmdline" in stated) == ("ros_node" in stated):
        message = "detect needs one of cmdline and ros_node"
        problems.add(
            fields.at("detect").mark,
            ProblemCode.CONTRADICTION,
            message,
            "write {cmdline: 'a regular expression'} or {ros_node: /name}",
        )


def check_draft(draft: TaskDraft, fleet: FleetIndex, problems: Problems) -> None:
    """What one expanded task asks of its robots."""
    _check_onboard(draft, fleet, problems)
    _check_robot_checks(draft, fleet, problems)
    _check_placeholders(draft, problems)
    _check_demand(draft, problems)


def _check_onboard(draft: TaskDraft, fleet: FleetIndex, problems: Problems) -> None:
    fields = draft.template.fields
    if fields.values.get("onboard") is not OnboardRule.ONLY:
        return
    mark = fields.at("onboard").mark
    if len(draft.robots) != 1:
        message = f"onboard: only needs exactly one robot, and {draft.name} has {len(draft.robots) or 'none'}"
        problems.add(
            mark, ProblemCode.CONTRADICTION, message, "write for_each: robot, or robot: .., or onboard: allow"
        )
    elif not fleet.hosts[draft.robots[0]].onboard:
        message = f"onboard: only, but {draft.robots[0]} runs no tasks"
        problems.add(
            mark,
            ProblemCode.CONTRADICTION,
            message,
            f"write onboard: true at {draft.robots[0]} in the inventory, or onboard: allow here",
        )


def _check_robot_checks(draft: TaskDraft, fleet: FleetIndex, problems: Problems) -> None:
    for key, check, node in _list_checks(draft.template.fields):
        if check.on is not CheckLocation.ROBOT:
            continue
        if len(draft.robots) != 1:
            message = f"{key} runs on the robot, and {draft.name} has {len(draft.robots) or 'none'}"
            problems.add(
                node.mark,
                ProblemCode.CONTRADICTION,
                message,
                f"write {key}: {{on: host, command: ..}}, or give the task one robot",
            )
        elif not fleet.hosts[draft.robots[0]].probe:
            message = f"{key} runs on {draft.robots[0]}, which has probe: false: it will never be answered"
            problems.add(
                node.mark,
                ProblemCode.NEVER_ANSWERED,
                message,
                "write on: host, or remove probe: false",
                warning=True,
            )


def _list_checks(fields: Fields) -> list[tuple[str, Check, Node]]:
    found: list[tuple[str, Check, Node]] = []
    found += [
        (key, fields.values[key], fields.at(key)) for key in ("ready", "done_when") if key in fields.values
    ]
    handoff = fields.values.get("handoff")
    inner = fields.at("handoff").value
    if handoff is not None and isinstance(inner, dict):
        hooks = ((key, getattr(handoff, key)) for key in ("safe_when", "hold", "release"))
        found += [(key, hook, inner[key]) for key, hook in hooks if hook is not None]
    return found


def _check_placeholders(draft: TaskDraft, problems: Problems) -> None:
    if len(draft.robots) == 1:
        return
    fields = draft.template.fields
    for key in ("command", "env", "workdir", "ready", "done_when", "handoff", "detect"):
        if has_placeholder(fields.values.get(key)):
            message = (
                "{robot} and {robot_host} need exactly one robot, "
                f"and {draft.name} has {len(draft.robots) or 'none'}"
            )
            problems.add(
                fields.at(key).mark,
                ProblemCode.PLACEHOLDER,
                message,
                "use $EDGECTL_ROBOTS, or give the task one robot: for_each: robot",
            )


def _check_demand(draft: TaskDraft, problems: Problems) -> None:
    fields = draft.template.fields
    if not fields.values.get("managed", True) or ("demand" in fields and "demand" not in fields.values):
        return
    demand = fields.values.get("demand", Demand())
    stated = fields.at("demand").value if "demand" in fields else {}
    left_out = [
        resource.demand_key
        for resource in RESOURCES
        if demand[resource.name] is None
        and not resource.declared_only
        and (draft.robots or not resource.per_link)
        and not (isinstance(stated, dict) and resource.demand_key in stated)
    ]
    if left_out:
        mark = fields.at("demand").mark if "demand" in fields else draft.template.named_at
        message = (
            f"{draft.template.name} states no demand for {', '.join(left_out)}: "
            "counted as 0 until it is measured"
        )
        hint = (
            f"add demand: {{{', '.join(f'{key}: ..' for key in left_out)}}}; "
            "write 0 or measured if that is intended"
        )
        problems.add(mark, ProblemCode.NO_DEMAND, message, hint, warning=True)


def resolve_host_rules(draft: TaskDraft, fleet: FleetIndex, problems: Problems) -> HostRules:
    """The ``hosts`` of a task, every name and label checked against the inventory."""
    fields: Fields | None = draft.template.fields.values.get("hosts")
    if fields is None:
        return HostRules()
    values = fields.values
    named = {key: _resolve_host_names(values.get(key, ()), fleet, problems) for key in ("only", "never")}
    if values.get("only") == ():
        problems.add(
            fields.at("only").mark,
            ProblemCode.CONTRADICTION,
            "only names no host",
            "name the hosts that may run it, or remove only",
        )
    _check_labels(fields, fleet, problems)
    pin = values.get("pin")
    if pin is not None:
        _check_pin(draft, pin, fields, named, fleet, problems)
    return HostRules(only=named["only"], never=named["never"], labels=values.get("labels", {}), pin=pin)


def _resolve_host_names(
    entries: tuple[tuple[str, Node], ...], fleet: FleetIndex, problems: Problems
) -> tuple[str, ...]:
    for name, node in entries:
        _check_host_exists(name, node, fleet.hosts, problems)
    return tuple(sorted({name for name, _ in entries}))


def _check_host_exists(name: str, node: Node, hosts: Mapping[str, Host], problems: Problems) -> bool:
    if name not in hosts:
        problems.add(
            node.mark,
            ProblemCode.UNKNOWN_NAME,
            f"unknown host {name}",
            problems.did_you_mean(name, hosts, "the hosts are"),
        )
    return name in hosts


def _check_pin(
    draft: TaskDraft,
    pin: str,
    fields: Fields,
    named: Mapping[str, Any],
    fleet: FleetIndex,
    problems: Problems,
) -> None:
    node = fields.at("pin")
    if not _check_host_exists(pin, node, fleet.hosts, problems):
        return
    host = fleet.hosts[pin]
    if host.role is Role.ROBOT and (draft.robots != (pin,) or not host.onboard):
        message = f"{draft.name} is pinned to the robot {pin}, which cannot run it"
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION,
            message,
            "pin it to an edge; only a task's own robot with onboard: true can run it",
        )
    elif pin in named["never"] or (named["only"] and pin not in named["only"]):
        message = f"{draft.name} is pinned to {pin}, which its own only and never exclude"
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION,
            message,
            f"remove pin, or take {pin} out of never and into only",
        )


def _check_labels(fields: Fields, fleet: FleetIndex, problems: Problems) -> None:
    wanted: Mapping[str, str] = fields.values.get("labels", {})
    node = fields.at("labels")
    for key, value in wanted.items():
        values = fleet.labels.get(key, frozenset())
        if value in values or not isinstance(node.value, dict):
            continue
        if values:
            hint = problems.did_you_mean(value, sorted(values), f"the values of {key} are")
            problems.add(
                node.value[key].mark, ProblemCode.UNKNOWN_NAME, f"no host has the label {key}: {value}", hint
            )
        else:
            hint = (
                problems.did_you_mean(key, fleet.labels, "the labels are")
                or f"add labels: {{{key}: {value}}} to a host of the inventory"
            )
            problems.add(node.key_mark(key), ProblemCode.UNKNOWN_NAME, f"no host has a label {key}", hint)
