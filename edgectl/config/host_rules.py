# SPDX-License-Identifier: Apache-2.0
"""Rules for hosts of a task, checked against the inventory."""

from collections.abc import Mapping
from typing import Any

from edgectl.config.fields import Fields
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.task_file import TaskDraft
from edgectl.dataclass import dataclass
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.task import (
    HostRules,
)


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
