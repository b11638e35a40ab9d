"""What labs get wrong in ROS and what the files already show: settings that differ between hosts whose nodes
should meet, one node name twice, questions to a graph that no host has.
"""

import re
from collections.abc import Iterable, Iterator, Mapping

from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.task_file import TaskDraft
from edgectl.model.inventory import Connection, Host, Inventory
from edgectl.model.task import Check, CheckLocation, Task

# Nodes meet only where these are the same.
_MEETING_VARIABLES = ("ROS_MASTER_URI", "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION")
_NODE_NAME = re.compile(r"(?:^|\s)__(?:name|node):=(\S+)")
_NAMESPACE = re.compile(r"(?:^|\s)__ns:=(\S+)")


def check_ros(
    tasks: Mapping[str, Task], drafts: Mapping[str, TaskDraft], inventory: Inventory, problems: Problems
) -> None:
    """Note what is wrong, at the name of the task that it concerns."""
    if not any(host.ros for host in inventory.hosts.values()) and not any(map(_list_checks, tasks.values())):
        return
    for name, task in tasks.items():
        hosts = _list_hosts(task, inventory)
        _check_meeting(task, hosts, inventory, drafts[name], problems)
        _check_questions(task, hosts, inventory, drafts[name], problems)
    _check_node_names(tasks, drafts, inventory, problems)


def _list_hosts(task: Task, inventory: Inventory) -> list[Host]:
    """The edges that may run the task."""
    return [host for host in inventory.edges if task.managed and task.hosts.allow(host.name, host.labels)]


def _get_variable(name: str, task: Task | None, host: Host) -> str | None:
    """The value of a variable for a task on a host; None where nothing states it."""
    stated = {**(host.ros.derive_variables() if host.ros is not None else {}), **host.env}
    value = {**stated, **(task.env if task is not None else {})}.get(name)
    return None if value is None else str(value)


def _check_meeting(
    task: Task, hosts: Iterable[Host], inventory: Inventory, draft: TaskDraft, problems: Problems
) -> None:
    robots = [inventory.hosts[name] for name in task.robots]
    for variable in _MEETING_VARIABLES:
        seen = {host.name: _get_variable(variable, task, host) for host in hosts}
        seen |= {
            robot.name: _get_variable(variable, None, robot) for robot in robots if robot.ros is not None
        }
        stated = {name: value for name, value in seen.items() if value is not None}
        if len(set(stated.values())) < 2:
            continue
        first = next(iter(stated))
        other = next(name for name, value in stated.items() if value != stated[first])
        problems.add(
            draft.template.named_at,
            ProblemCode.ROS,
            f"{variable} of {draft.name} is {stated[first]} on {first} and {stated[other]} on {other}: "
            "their nodes never meet",
            "state the same ros: for both in the inventory, or the variable in the env of the task",
            warning=True,
        )


def _list_checks(task: Task) -> list[Check]:
    """The questions of a task to the ROS graph."""
    alive = task.alive.check if task.alive is not None else None
    found = (task.ready, alive, task.done_when, task.handoff.safe_when)
    return [check for check in found if check is not None and check.ros is not None]


def _check_questions(
    task: Task, hosts: list[Host], inventory: Inventory, draft: TaskDraft, problems: Problems
) -> None:
    for check in _list_checks(task):
        asked = [inventory.hosts[name] for name in task.robots] if check.on is CheckLocation.ROBOT else hosts
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


def _list_node_names(task: Task) -> Iterator[str]:
    """Names of nodes that the command gives, and that of the node that must be alive."""
    spaces = _NAMESPACE.findall(task.command)
    space = spaces[0].strip("/") if len(spaces) == 1 else ""
    for name in dict.fromkeys(_NODE_NAME.findall(task.command)):
        yield "/" + "/".join(part for part in (space, name.strip("/")) if part)
    ros = task.alive.check.ros if task.alive is not None else None
    if ros is not None and ros.node is not None:
        yield ros.node


def _check_node_names(
    tasks: Mapping[str, Task], drafts: Mapping[str, TaskDraft], inventory: Inventory, problems: Problems
) -> None:
    """Note each node name that two tasks of one graph have."""
    owners: dict[tuple[str, ...], str] = {}
    for name, task in tasks.items():
        if not task.managed:
            continue
        hosts = _list_hosts(task, inventory) or list(inventory.edges)
        graph = tuple(
            (_get_variable(each, task, hosts[0]) or "") if hosts else "" for each in _MEETING_VARIABLES
        )
        for node in dict.fromkeys(_list_node_names(task)):
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

    Where all hosts are this machine, that is right.
    """
    if all(host.connection is Connection.LOCAL or is_loopback(host.host) for host in hosts.values()):
        return
    for host in hosts.values():
        for name in ("ROS_IP", "ROS_HOSTNAME", "ROS_MASTER_URI"):
            value = _get_variable(name, None, host)
            if value is not None and is_loopback(value):
                yield host, f"{name} of {host.name} is {value}, which means another machine on each host"
