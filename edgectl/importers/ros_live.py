# SPDX-License-Identifier: Apache-2.0
"""Nodes of running ROS graphs as unmanaged tasks, with the needs that their topics show."""

import re
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field

from edgectl.config.problems import ProblemCode
from edgectl.errors import Problem
from edgectl.importers.ros_tasks import ROSCORE, to_host_name
from edgectl.importers.yaml_text import FileEntry, FileText
from edgectl.model.ros import GraphNode, RosGraph
from edgectl.model.task import Task
from edgectl.names import natural_key

_NODE_NAME = re.compile(r"(/[A-Za-z0-9_~]+)+")
# What rospy and roslaunch add to the name of a node that is to be the only one of its name.
_ANONYMOUS = re.compile(r"_\d+_\d{12,}$")
# Every node has a part in these.
_COMMON_TOPICS = {"/rosout", "/rosout_agg", "/parameter_events"}
_SHOWN_TOPICS = 8
_SPECIAL = re.compile(r"[][\\.^$*+?{}()|]")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Process:
    """The nodes of one process on one host; ``task``: the known task that it belongs to, or its new one."""

    host: str
    nodes: list[GraphNode]
    task: str
    rule: Mapping[str, str] = field(default_factory=dict)


class _Notes:
    """What could not be known."""

    def __init__(self) -> None:
        self.found: list[Problem] = []

    def add(self, host: str, message: str, hint: str = "") -> None:
        code = ProblemCode.NOT_IMPORTED.value
        self.found.append(
            Problem(file=host, line=0, column=0, code=code, message=message, hint=hint, warning=True)
        )


def build_live_tasks(
    graphs: Mapping[str, RosGraph], fleet: str, robots: Sequence[str], known: Mapping[str, Task]
) -> tuple[FileText, tuple[Problem, ...]]:
    """The task file, without tasks if no node is new, and what could not be known.

    ``graphs``: by host; ``robots``: their names, each the first namespace of its nodes; ``known``: the tasks
    of the fleet, whose nodes are no new tasks.
    """
    notes = _Notes()
    found = _list_processes(graphs, fleet, known, notes)
    needs = _find_needs(found, known, notes)
    entries = [
        _build_entry(process, needs.get(process.task, ()), robots) for process in found if process.rule
    ]
    comments = (
        f"Read from the running ROS graph of {', '.join(graphs)}.",
        "edgectl measures these tasks and never starts or stops them. To have it start one, write",
        "command: .. in place of managed: and detect:, and end the process that runs.",
    )
    return FileText(comments=comments, keys={"version": 1}, sections={"tasks": entries}), tuple(notes.found)


def _list_processes(
    graphs: Mapping[str, RosGraph], fleet: str, known: Mapping[str, Task], notes: _Notes
) -> list[_Process]:
    """The processes of the graphs, of known tasks and of new ones, the master first."""
    groups: dict[tuple[str, int], list[GraphNode]] = {}
    placed: set[str] = set()
    for host, graph in graphs.items():
        for node in graph.nodes:
            if node.pid and (not node.name or _NODE_NAME.fullmatch(node.name)):
                groups.setdefault((host, node.pid), []).append(node)
                placed.add(node.name)
    _note_unplaced(graphs, placed, notes)
    taken = {*known}
    found = []
    ordered = sorted(groups.items(), key=lambda item: (bool(item[1][0].name), natural_key(item[1][0].name)))
    twice = _find_repeated(nodes[0] for nodes in groups.values())
    for (host, _), nodes in ordered:
        owner = _find_owner(nodes, host, fleet, known, notes)
        if owner is None:
            continue
        if owner:
            found.append(_Process(host=host, nodes=nodes, task=owner))
        elif rule := _choose_rule(nodes, host, notes):
            name = _choose_name(nodes[0], host, twice, taken)
            taken.add(name)
            found.append(_Process(host=host, nodes=nodes, task=name, rule=rule))
    return found


def _note_unplaced(graphs: Mapping[str, RosGraph], placed: Set[str], notes: _Notes) -> None:
    """Note each node whose process is not known on any of the hosts, once."""
    said: set[str] = set()
    for host, graph in graphs.items():
        if graph.left_out:
            notes.add(host, f"{graph.left_out} more nodes are left out: the graph is too large for one reply")
        for node in graph.nodes:
            if node.name in placed or node.name in said or not node.name:
                continue
            said.add(node.name)
            notes.add(host, *_describe_unplaced(node))


def _describe_unplaced(node: GraphNode) -> tuple[str, str]:
    """What is not known of a node, and what to do about it."""
    if not _NODE_NAME.fullmatch(node.name):
        return f"{node.name!r} is no name of a node", ""
    if node.fault:
        return f"{node.name} is registered and {node.fault}", "remove what is left of it: rosnode cleanup"
    if node.here is False:
        place = f" at {node.address}" if node.address else ""
        return f"{node.name} runs on another host{place}", "name that host too: --live HOST"
    return (
        f"the process of {node.name} is not known",
        "write a task with managed: false and detect: {cmdline: ..} by hand",
    )


def _find_repeated(nodes: Iterable[GraphNode]) -> set[str]:
    """The last parts of names that several nodes have."""
    seen: set[str] = set()
    return {
        short
        for node in nodes
        if (short := _shorten(node.name)) in seen or seen.add(short)  # type: ignore[func-returns-value]
    }


def _shorten(name: str) -> str:
    return _ANONYMOUS.sub("", name.rpartition("/")[2])


def _find_owner(
    nodes: Sequence[GraphNode], host: str, fleet: str, known: Mapping[str, Task], notes: _Notes
) -> str | None:
    """The known task of a process; empty where it has none, None where it is another's."""
    shown = nodes[0].name or "the master"
    if nodes[0].task:
        owner, _, task = nodes[0].task.partition("/")
        task = task.rpartition("/")[2]
        if owner == fleet and task in known:
            return task
        notes.add(host, f"{shown} is task {task or '?'} of the fleet {owner}")
        return None
    line = " ".join(nodes[0].words)
    for name, each in known.items():
        if each.detect is None:
            continue
        stated, pattern = each.detect.ros_node, each.detect.cmdline
        if stated in [node.name for node in nodes] or (pattern is not None and re.search(pattern, line)):
            return name
    return ""


def _choose_rule(nodes: Sequence[GraphNode], host: str, notes: _Notes) -> Mapping[str, str]:
    """The rule by which a process is found again; empty, and noted, where there is none."""
    named = [node.name for node in nodes if node.named and not _ANONYMOUS.search(node.name)]
    if named:
        return {"ros_node": named[0]}
    shown = nodes[0].name or "the master"
    words = nodes[0].words
    if not words:
        notes.add(host, f"the command line of {shown} cannot be read", "write its task by hand")
        return {}
    if nodes[0].alike:
        message = (
            f"{nodes[0].alike} other processes have the command line of {shown}: its task counts them too"
        )
        notes.add(host, message, "write a pattern that only this one has: detect: {cmdline: ..}")
    return {"cmdline": "^" + _SPECIAL.sub(r"\\\g<0>", " ".join(words)) + "( |$)"}


def _choose_name(node: GraphNode, host: str, twice: Set[str], taken: Set[str]) -> str:
    """A name that no other task has: that of the node, with its namespace where another has the same."""
    if not node.name:
        base = ROSCORE
    elif _shorten(node.name) in twice:
        base = to_host_name(_ANONYMOUS.sub("", node.name).strip("/").replace("/", "-"))
    else:
        base = to_host_name(_shorten(node.name))
    choices = (base, to_host_name(f"{base}-{host}"), *(f"{base}-{number}" for number in range(2, 9999)))
    return next(name for name in choices if name not in taken)


def _find_needs(
    found: Sequence[_Process], known: Mapping[str, Task], notes: _Notes
) -> dict[str, tuple[str, ...]]:
    """The tasks from which each new one hears something, and the master; not where they hear each other."""
    publishers: dict[str, set[str]] = {}
    for process in found:
        for topic in _list_topics(process.nodes, "publishes"):
            publishers.setdefault(topic, set()).add(process.task)
    needs: dict[str, set[str]] = {name: {need.task for need in task.needs} for name, task in known.items()}
    masters = {process.host: process.task for process in found if not process.nodes[0].name}
    for process in found:
        if not process.rule:
            continue
        heard = _list_topics(process.nodes, "subscribes")
        needed = {task for topic in heard for task in publishers.get(topic, ())} - {process.task}
        if process.nodes[0].name:
            needed |= {masters[process.host]} if process.host in masters else set(masters.values())
        needs[process.task] = needed
    return _drop_circles({process.task: process.host for process in found if process.rule}, needs, notes)


def _drop_circles(
    new: Mapping[str, str], needs: Mapping[str, Set[str]], notes: _Notes
) -> dict[str, tuple[str, ...]]:
    """The needs of the ``new`` tasks (with their hosts) that do not lead back to the task itself."""
    reach = {name: _find_reachable(name, needs) for name in {*new, *needs}}
    for name, host in new.items():
        circle = sorted((other for other in reach[name] if name in reach.get(other, ())), key=natural_key)
        if len(circle) > 1 and next(each for each in circle if each in new) == name:
            notes.add(host, f"{', '.join(circle)} depend on each other: no needs are written between them")
    return {
        name: tuple(
            sorted((each for each in needs[name] if name not in reach.get(each, ())), key=natural_key)
        )
        for name in new
    }


def _find_reachable(start: str, needs: Mapping[str, Set[str]]) -> set[str]:
    """Everything that ``start`` needs, directly or not."""
    found: set[str] = set()
    todo = [*needs.get(start, ())]
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += needs.get(name, ())
    return found


def _list_topics(nodes: Sequence[GraphNode], key: str) -> list[str]:
    """The topics that nodes publish or subscribe to, without those in which every node has a part."""
    topics = {topic for node in nodes for topic in getattr(node, key)}
    return sorted(topics - _COMMON_TOPICS, key=natural_key)


def _build_entry(process: _Process, needs: Sequence[str], robots: Sequence[str]) -> FileEntry:
    values: dict[str, object] = {}
    first = process.nodes[0].name.strip("/").split("/")[0]
    if first in robots:
        values["robot"] = first
    values |= {"managed": False, "detect": dict(process.rule)}
    if needs:
        values["needs"] = list(needs)
    names = ", ".join(node.name for node in process.nodes) or "The master of ROS 1"
    comments = [f"{names} on {process.host}"]
    for verb, key in (("publishes", "publishes"), ("subscribes to", "subscribes")):
        topics = _list_topics(process.nodes, key)
        more = f" and {len(topics) - _SHOWN_TOPICS} more" if len(topics) > _SHOWN_TOPICS else ""
        if topics:
            comments.append(f"{verb} {', '.join(topics[:_SHOWN_TOPICS])}{more}")
    return FileEntry(name=process.task, values=values, comments=tuple(comments))
