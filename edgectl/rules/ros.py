# SPDX-License-Identifier: Apache-2.0
"""ROS in the request for a command: set-up files, placeholders that its host fills in, questions."""

import re
from collections.abc import Iterable, Mapping
from urllib.parse import urlsplit

from edgectl.model.check import Check
from edgectl.model.inventory import Host, Role
from edgectl.model.ros import HOST_PLACEHOLDERS, MASTER, ROBOT_ADDRESS, RosCheck
from edgectl.model.task import Task

Document = dict[str, object]
# A word with a slash or a dot is a file, not a package.
_PACKAGE = r"\b(?:rosrun|roslaunch|ros2\s+run|ros2\s+launch)\s+([A-Za-z][A-Za-z0-9_-]*)(?=\s)"


def encode_ros(task: Task, host: Host, hosts: Mapping[str, Host]) -> Document | None:
    """The part ``ros`` of a request that runs a command of ``task`` on ``host``; None where it needs none.

    ``peers``: whom the nodes of the host must reach, so that it finds its address on that way.
    """
    if host.ros is None and not _has_host_placeholder(task):
        return None
    robots = [hosts[robot].host for robot in task.robots if robot in hosts]
    return _encode_ros(host, robots, {ROBOT_ADDRESS: robots[0]} if len(robots) == 1 else {})


def encode_host_ros(host: Host, robots: Iterable[str]) -> Document | None:
    """The same for a request that belongs to no task; ``robots``: their addresses."""
    return None if host.ros is None else _encode_ros(host, robots, {})


def _encode_ros(host: Host, robots: Iterable[str], values: Mapping[str, str]) -> Document:
    master = host.ros.master if host.ros is not None else None
    others = [urlsplit(master).hostname or ""] if master is not None else []
    return {
        "version": host.ros.version if host.ros is not None else 1,
        "setup": list(host.ros.setup) if host.ros is not None else [],
        "peers": [*robots, *others],
        "values": {**values, **({MASTER: master} if master is not None else {})},
    }


def _has_host_placeholder(task: Task) -> bool:
    texts = [task.command, *(str(value) for value in task.env.values())]
    alive = task.alive.check if task.alive is not None else None
    hooks = (task.handoff.safe_when, task.handoff.hold, task.handoff.release)
    texts += [check.command for check in (task.ready, alive, task.done_when, *hooks) if check is not None]
    return any(f"{{{name}}}" in text for name in HOST_PLACEHOLDERS for text in texts)


def list_ros_packages(tasks: Mapping[str, Task], host: Host) -> dict[str, str]:
    """Packages of ROS that commands run on ``host``, each with the first task that does."""
    found: dict[str, str] = {}
    for name, task in tasks.items():
        allowed = host.role is Role.EDGE and task.hosts.allow(host.name, host.labels)
        if task.managed and (allowed or (host.onboard and task.robots == (host.name,))):
            for package in re.findall(_PACKAGE, task.command):
                found.setdefault(package, name)
    return found


def encode_question(check: Check, host: Host) -> Document:
    """The keys of a request that ask what ``check`` asks."""
    if check.ros is None:
        return {"command": check.command, "graph": None}
    return {"command": "", "graph": _encode_graph_question(check.ros, host)}


def fill_host_name(name: str, host: Host) -> str:
    """Fill in ``{host}`` in a name of the graph: copies of one node on several hosts need names of their own.

    Letters that such names cannot have become ``_``.
    """
    return name.replace("{host}", re.sub(r"[^A-Za-z0-9]", "_", host.name))


def _encode_graph_question(asked: RosCheck, host: Host) -> Document:
    topic = asked.topic
    return {
        "version": host.ros.version if host.ros is not None else 1,
        "node": None if asked.node is None else fill_host_name(asked.node, host),
        "topic": None if topic is None else {"name": topic.name, "within_s": topic.within},
        "service": asked.service,
        "lifecycle": asked.lifecycle,
    }
