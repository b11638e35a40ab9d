# SPDX-License-Identifier: Apache-2.0
"""Common mistakes with ROS that the files alone show: settings that differ between hosts whose nodes
should meet, one node name twice, questions to a graph that no host has.
"""

import re
from collections.abc import Iterator, Mapping

from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.task_file import TaskDraft
from edgectl.model.check import Check, CheckLocation
from edgectl.model.inventory import Connection, Host, Inventory
from edgectl.model.task import Task, list_node_names

# Nodes meet only where these are the same.
_MEETING_VARIABLES = ("ROS_MASTER_URI", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION")


def check_ros(
    tasks: Mapping[str, Task], drafts: Mapping[str, TaskDraft], inventory: Inventory, problems: Problems
) -> None:
    """Note what is wrong, at the name of the task that it concerns."""
    if not any(host.ros for host in inventory.hosts.values()) and not any(map(_list_checks, tasks.values())):
        return
    places = _Places(inventory)
    for name, task in tasks.items():
        _check_meeting(task, places, drafts[name], problems)
        _check_questions(task, places, drafts[name], problems)
    _check_node_names(tasks, drafts, places, problems)


class _Places:
    """The edges that may run a task, and what they state: looked up once for equal rules of tasks."""

    def __init__(self, inventory: Inventory) -> None:
        self.hosts = inventory.hosts
        self._edges = inventory.edges
        self._allowed: dict[object, list[Host]] = {}
        self._values: dict[object, dict[str, str]] = {}

    def list_hosts(self, task: Task) -> list[Host]:
        """The edges that may run the task."""
        key = self._build_key(task)
        if key not in self._allowed:
            self._allowed[key] = [
                host for host in self._edges if task.managed and task.hosts.allow(host.name, host.labels)
            ]
        return self._allowed[key]

    def list_values(self, variable: str, task: Task) -> dict[str, str]:
        """Each value of a variable on the hosts of the task, with the first host that states it."""
        if variable in task.env:
            return {str(task.env[variable]): host.name for host in self.list_hosts(task)[:1]}
        key = (variable, self._build_key(task))
        if key not in self._values:
            found: dict[str, str] = {}
            for host in self.list_hosts(task):
                value = _get_variable(variable, None, host)
                if value is not None:
                    found.setdefault(value, host.name)
            self._values[key] = found
        return self._values[key]

    @staticmethod
    def _build_key(task: Task) -> object:
        rules = task.hosts
        return task.managed, rules.only, rules.never, rules.pin, tuple(sorted(rules.labels.items()))


def _get_variable(name: str, task: Task | None, host: Host) -> str | None:
    """The value of a variable for a task on a host; None where nothing states it."""
    stated = {**(host.ros.derive_variables() if host.ros is not None else {}), **host.env}
    value = {**stated, **(task.env if task is not None else {})}.get(name)
    return None if value is None else str(value)


def _check_meeting(task: Task, places: _Places, draft: TaskDraft, problems: Problems) -> None:
    robots = [places.hosts[name] for name in task.robots]
    for variable in _MEETING_VARIABLES:
        found = dict(places.list_values(variable, task))
        for robot in robots:
            value = _get_variable(variable, None, robot) if robot.ros is not None else None
            if value is not None:
                found.setdefault(value, robot.name)
        if len(found) < 2:
            continue
        (value, first), (other, second) = list(found.items())[:2]
        problems.add(
            draft.template.named_at,
            ProblemCode.ROS,
            f"{variable} of {draft.name} is {value} on {first} and {other} on {second}: "
            "their nodes never meet",
            "state the same ros: for both in the inventory, or the variable in the env of the task",
            warning=True,
        )


def _list_checks(task: Task) -> list[Check]:
    """The questions of a task to the ROS graph."""
    alive = task.alive.check if task.alive is not None else None
    found = (task.ready, alive, task.done_when, task.handoff.safe_when)
    return [check for check in found if check is not None and check.ros is not None]


def _check_questions(task: Task, places: _Places, draft: TaskDraft, problems: Problems) -> None:
    for check in _list_checks(task):
        on_robot = check.on is CheckLocation.ROBOT
        asked = [places.hosts[name] for name in task.robots] if on_robot else places.list_hosts(task)
        for host in asked:
            fault = _find_question_fault(check, task, host)
            if fault:
                problems.add(
                    draft.template.named_at,
                    ProblemCode.ROS,
                    f"{draft.name} asks the ROS graph on {host.name}, {fault[0]}",
                    fault[1],
                    warning=True,
                )
                break


def _find_question_fault(check: Check, task: Task, host: Host) -> tuple[str, str] | None:
    version = host.ros.version if host.ros is not None else 1
    if check.ros is not None and check.ros.lifecycle and version == 1:
        return "whose ROS 1 has no lifecycle", "remove ros_lifecycle"
    if version == 1 and not _get_variable("ROS_MASTER_URI", task, host):
        return (
            "which has no ROS master",
            f"state ros: {{version: 1, master: ..}} of {host.name}, or of defaults, in the inventory",
        )
    return None


def _check_node_names(
    tasks: Mapping[str, Task], drafts: Mapping[str, TaskDraft], places: _Places, problems: Problems
) -> None:
    """Note each node name that two tasks of one graph have."""
    owners: dict[tuple[str, ...], str] = {}
    for name, task in tasks.items():
        if not task.managed:
            continue
        graph = tuple(next(iter(places.list_values(each, task)), "") for each in _MEETING_VARIABLES)
        for node in list_node_names(task):
            other = owners.setdefault((node, *graph), name)
            if other != name:
                problems.add(
                    drafts[name].template.named_at,
                    ProblemCode.ROS,
                    f"{other} and {name} start nodes of one name, {node}: in ROS 1 the second ends the first",
                    "write {robot} into the name, as in __name:={robot}_slam, or a namespace: __ns:=/{robot}",
                    warning=True,
                )


def is_loopback(text: object) -> bool:
    """Whether an address or a URI means the machine that reads it."""
    host = re.sub(r"^\w+://", "", str(text)).split("/")[0]
    return host.startswith(("127.", "localhost", "[::1]")) or host == "::1"


def check_host_addresses(hosts: Mapping[str, Host]) -> Iterator[tuple[Host, str]]:
    """Hosts whose nodes others cannot reach, with the reason: an address or a master that is each host's own.

    Where all hosts are this machine, that is right; hosts that are never contacted do not count.
    """
    contacted = [host for host in hosts.values() if host.probe]
    if all(host.connection is Connection.LOCAL or is_loopback(host.host) for host in contacted):
        return
    for host in contacted:
        for name in ("ROS_IP", "ROS_HOSTNAME", "ROS_MASTER_URI"):
            value = _get_variable(name, None, host)
            if value is not None and is_loopback(value):
                yield host, f"{name} of {host.name} is {value}, which means another machine on each host"
