# SPDX-License-Identifier: Apache-2.0
"""Nodes of a launch file as tasks, one entry for all robots whose namespaces repeat, and an inventory."""

import posixpath
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from edgectl.importers.launch_values import Launch, Machine, RosNode
from edgectl.importers.ros_command import (
    build_command,
    build_computed_step,
    format_json,
    join_words,
    list_plain_env,
)
from edgectl.importers.yaml_text import FileEntry, FileText

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,40}")
_LOCAL = ("localhost", "127.0.0.1", "::1")
_MAX_NAME = 40
_KEY_ORDER = ("for_each", "robot", "command", "kind", "needs", "demand", "env", "workdir", "onboard", "hosts",
              "stop", "restart")  # fmt: skip
ROSCORE, PARAMETERS = "roscore", "parameters"
EMPTY_EDGE = "edge1"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedFiles:
    """The two files of an import."""

    inventory: FileText
    tasks: FileText


@dataclass(slots=True, kw_only=True)
class _Group:
    """The nodes of one entry of the task file. ``robots``: those of their namespaces."""

    nodes: list[RosNode]
    robots: list[str]
    values: dict[str, object]
    name: str = ""


def build_files(launch: Launch, title: str, fleet: str) -> ImportedFiles:
    """Task file and inventory of what was read. ``title`` names the files, ``fleet`` the fleet."""
    robots = find_robots(launch.nodes)
    groups = _group_nodes(launch.nodes, robots)
    _name_groups(groups)
    edges = [machine for machine in launch.machines.values() if machine.name not in robots]
    master = to_host_name(edges[0].name) if edges else EMPTY_EDGE
    has_ros1 = any(node.version == 1 for node in launch.nodes)
    entries = _build_service_entries(launch, master) if has_ros1 else []
    entries += [_build_entry(group, groups, bool(launch.parameters or launch.computed)) for group in groups]
    about = f"Imported from {title}."
    tasks = FileText(comments=(about,), keys={"version": 1}, sections={"tasks": entries})
    return ImportedFiles(inventory=_build_inventory(launch, robots, about, fleet, master), tasks=tasks)


def find_robots(nodes: Sequence[RosNode]) -> list[str]:
    """The namespaces in which the same node runs, in the order of the file: one per robot."""
    seen: dict[object, list[str]] = defaultdict(list)
    for node in nodes:
        robot = _get_first_namespace(node)
        if robot and _NAME.fullmatch(robot):
            seen[node.name, build_task_text(node, robot)].append(robot)
    repeated = {robot for group in seen.values() if len(set(group)) > 1 for robot in group}
    ordered = dict.fromkeys(_get_first_namespace(node) for node in nodes)
    return [robot for robot in ordered if robot in repeated]


def _get_first_namespace(node: RosNode) -> str:
    return node.namespace.strip("/").split("/")[0]


def build_task_text(node: RosNode, robot: str) -> str:
    """The command of a node with the name of its robot replaced by its placeholder."""
    return fill_in_robot(build_command(node), robot)


def fill_in_robot(text: str, robot: str) -> str:
    """``text`` with ``{robot}`` wherever ``robot`` stands as a word, or next to an underscore."""
    if not robot:
        return text
    return re.sub(rf"(?<![A-Za-z0-9]){re.escape(robot)}(?![A-Za-z0-9])", "{robot}", text)


def _group_nodes(nodes: Sequence[RosNode], robots: Sequence[str]) -> list[_Group]:
    groups: dict[object, _Group] = {}
    for node in nodes:
        first = _get_first_namespace(node)
        robot = first if first in robots else ""
        values = _build_values(node, robot)
        key: object = (node.name, repr(values)) if robot else node.order
        if key in groups and robot in groups[key].robots:
            key = node.order
        group = groups.setdefault(key, _Group(nodes=[], robots=[], values=values))
        group.nodes.append(node)
        group.robots += [robot] if robot else []
    for group in groups.values():
        group.values = _add_robots(group, robots)
    return list(groups.values())


def _add_robots(group: _Group, robots: Sequence[str]) -> dict[str, object]:
    """The values with the key that names their robots; one robot alone is named in the command."""
    if not group.robots:
        return group.values
    if len(group.robots) == 1:
        own = _build_values(group.nodes[0], group.robots[0], literally=True)
        return {"robot": group.robots[0], **own}
    each: object = "robot" if set(group.robots) == set(robots) else group.robots
    return {"for_each": each, **group.values}


def _build_values(node: RosNode, robot: str, *, literally: bool = False) -> dict[str, object]:
    """The keys of the task that runs a node."""
    placeholder = "" if literally else robot
    env = {name: fill_in_robot(value, placeholder) for name, value in list_plain_env(node).items()}
    values: dict[str, object] = {"command": build_task_text(node, placeholder), "demand": "measured"}
    if env:
        values["env"] = env
    if node.workdir:
        values["workdir"] = fill_in_robot(node.workdir, placeholder)
    if node.machine and node.machine == robot:
        values["onboard"] = "only"
    elif node.machine:
        values["hosts"] = {"pin": to_host_name(node.machine)}
    values["stop"] = "ros" if node.executable == "roslaunch" else {"signal": "INT"}
    if node.respawn is not None:
        values["restart"] = "always" if node.respawn else "never"
    return values


def to_host_name(name: str) -> str:
    """``name`` as the name of a host or task: lower case, of the characters that names have."""
    text = re.sub(r"[^a-z0-9._-]+", "-", name.lower()).strip("-._")
    return text[:_MAX_NAME].rstrip("-._") or "unnamed"


def _name_groups(groups: Sequence[_Group]) -> None:
    taken = {ROSCORE, PARAMETERS}
    for group in groups:
        node = group.nodes[0]
        short = to_host_name(node.name or node.executable)
        long = to_host_name(f"{node.namespace.strip('/')}-{short}") if len(group.robots) < 2 else short
        number = 1
        name = short
        while not taken.isdisjoint(_list_task_names(name, group)):
            number += 1
            name = long if number == 2 and long != short else f"{long}-{number}"
        group.name = name
        taken |= set(_list_task_names(name, group))


def _list_task_names(name: str, group: _Group) -> list[str]:
    return [name, *(f"{name}-{robot}" for robot in group.robots)] if len(group.robots) > 1 else [name]


def _build_entry(group: _Group, groups: Sequence[_Group], has_parameters: bool) -> FileEntry:  # noqa: FBT001
    values = dict(group.values)
    needs: list[object] = []
    if group.nodes[0].version == 1:
        needs.append({"task": ROSCORE, "restart": "with"})
        if has_parameters:
            needs.append({"task": PARAMETERS, "until": "completed"})
    needs += _build_needs(group, groups)
    if needs:
        values["needs"] = needs
    awaited = {
        order for each in groups for node in each.nodes for order, state in node.needs if state == "completed"
    }
    if any(node.order in awaited for node in group.nodes):
        values["kind"] = "job"
    values = {key: values[key] for key in sorted(values, key=_KEY_ORDER.index)}
    places = dict.fromkeys(
        f"{posixpath.basename(node.mark.source.file)}:{node.mark.line}" for node in group.nodes
    )
    return FileEntry(name=group.name, values=values, comments=(", ".join(list(places)[:5]),))


def _build_needs(group: _Group, groups: Sequence[_Group]) -> list[object]:
    by_position = {node.order: each for each in groups for node in each.nodes}
    found: dict[str, str] = {}
    for node in group.nodes:
        for position, state in node.needs:
            needed = by_position.get(position)
            if needed is None or needed is group:
                continue
            alone = len(needed.robots) > 1 and len(group.robots) == 1
            found[f"{needed.name}-{group.robots[0]}" if alone else needed.name] = state
    return [name if state == "ready" else {"task": name, "until": state} for name, state in found.items()]


def _build_service_entries(launch: Launch, master: str) -> list[FileEntry]:
    """The master of ROS 1, and the job that sets the global parameters."""
    core = FileEntry(
        name=ROSCORE,
        comments=("The master of ROS 1. Remove it, and the needs for it, where another one is used.",),
        values={
            "command": "roscore",
            "demand": "measured",
            "hosts": {"pin": master},
            "ready": {"command": "rosparam get /rosversion", "timeout": "30s"},
            "stop": "ros",
        },
    )
    if not launch.parameters and not launch.computed:
        return [core]
    words = ["rosparam", "set", "/", format_parameter_tree(launch.parameters)]
    steps = [join_words(words, 1)] if launch.parameters else []
    steps += [build_computed_step(name, each) for name, each in launch.computed.items()]
    values = {
        "command": " && ".join(steps),
        "demand": "measured",
        "kind": "job",
        "needs": [{"task": ROSCORE, "restart": "with"}],
    }
    return [core, FileEntry(name=PARAMETERS, values=values)]


def format_parameter_tree(parameters: Mapping[str, object]) -> str:
    """Parameters by full name as one mapping in JSON, which rosparam merges into those that are set."""
    tree: dict[str, object] = {}
    for name, value in parameters.items():
        place = tree
        *above, last = name.strip("/").split("/")
        for part in above:
            inner = place.setdefault(part, {})
            if not isinstance(inner, dict):
                place[part] = inner = {}
            place = inner
        place[last] = value
    return format_json(tree)


def _build_inventory(launch: Launch, robots: Sequence[str], about: str, fleet: str, master: str) -> FileText:
    machines = {to_host_name(machine.name): machine for machine in launch.machines.values()}
    edges = [_build_host(name, machine) for name, machine in machines.items() if name not in robots]
    if not edges:
        comment = "This machine. Write the edges of the lab instead."
        edges = [FileEntry(name=EMPTY_EDGE, values={"connection": "local"}, comments=(comment,))]
    onboard = {node.machine for node in launch.nodes if node.machine in robots}
    robot_entries = [_build_robot(robot, machines.get(robot), onboard=robot in onboard) for robot in robots]
    keys: dict[str, object] = {"version": 1, "fleet": fleet}
    versions = {node.version for node in launch.nodes}
    if len(versions) == 1:
        ros = {"version": 1, "master": master} if versions == {1} else {"version": 2}
        keys["defaults"] = {"ros": ros}
    comments = (about, "Add the setup files of ROS to ros: in defaults: setup: [/opt/ros/DISTRO/setup.bash]")
    return FileText(comments=comments, keys=keys, sections={"edges": edges, "robots": robot_entries})


def _build_host(name: str, machine: Machine) -> FileEntry:
    if machine.address in _LOCAL:
        return FileEntry(name=name, values={"connection": "local"})
    values: dict[str, object] = {"host": machine.address}
    if machine.user:
        values["user"] = machine.user
    if machine.port:
        values["port"] = machine.port
    return FileEntry(name=name, values=values)


def _build_robot(robot: str, machine: Machine | None, *, onboard: bool) -> FileEntry:
    if machine is None:
        comment = "Write its address; remove probe: false if it has SSH."
        return FileEntry(name=robot, values={"host": robot, "probe": False}, comments=(comment,))
    entry = _build_host(robot, machine)
    return FileEntry(name=robot, values={**entry.values, **({"onboard": True} if onboard else {})})
