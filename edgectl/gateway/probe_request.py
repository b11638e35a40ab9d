# SPDX-License-Identifier: Apache-2.0
"""Probe requests: links to measure, tasks to detect, checks to run."""

from collections.abc import Mapping

from edgectl.agent.link import protocol
from edgectl.gateway.latency import encode_latency_rules
from edgectl.model.check import Check, CheckLocation
from edgectl.model.image import ContainerEngine
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.task import DetectRule, Task, Tasks
from edgectl.rules.environment import drop_secrets, merge_environment
from edgectl.rules.ros import encode_question, encode_ros

# Time of a probe besides its window and its checks.
_OVERHEAD_S = 4.0


def build_probe_request(
    host: Host,
    inventory: Inventory,
    tasks: Tasks,
    addresses: Mapping[str, str],
    *,
    window_s: float,
    timeout_s: float,
    former: frozenset[str] = frozenset(),
    edges: Mapping[str, str] | None = None,
    manager_id: str = "",
    placed: Mapping[str, str] | None = None,
    totals: bool = False,
) -> dict[str, object]:
    """The probe request of one host; ``addresses`` are the robots' and ``edges`` the edges' as the network
    knows them.

    ``former``: names of hosts that left the inventory, of which this host may be one.
    ``manager_id``: the name by which hosts know this manager. ``placed``: the instance of each task.
    ``totals``: also ask for the counters of the host.
    Checks are cut short, so that a slow one fails in time instead of the whole probe.
    """
    longest = max(1.0, timeout_s - window_s - _OVERHEAD_S)
    return {
        "op": protocol.OP_PROBE,
        "fleet": host.fleet,
        "host": host.name,
        "window_s": window_s,
        **build_probe_spec(host, tasks, addresses, edges),
        "checks": [
            _encode_done_check(task, task.done_when, host, inventory, longest)
            for task in tasks.tasks.values()
            if task.done_when and _can_check_done(task, host)
        ],
        "latency": encode_latency_rules(host, inventory, tasks, placed or {}),
        "former": sorted(former),
        "manager": manager_id,
        **({"totals": True} if totals else {}),
        **_encode_engines(tasks),
    }


def _encode_engines(tasks: Tasks) -> dict[str, object]:
    """Whether container engines are asked for, and whether docker is asked for its swarm."""
    images = [task.image for task in tasks.tasks.values() if task.image]
    swarm = any(image.engine is ContainerEngine.SWARM for image in images)
    return {**({"engines": True} if images else {}), **({"swarm": True} if swarm else {})}


def build_probe_spec(
    host: Host, tasks: Tasks, addresses: Mapping[str, str], edges: Mapping[str, str] | None = None
) -> dict[str, object]:
    """The links to measure on an edge, the edges whose connections a robot watches (``peers``), and the
    unmanaged tasks to detect.
    """
    is_edge = host.role is Role.EDGE
    return {
        "links": encode_addresses(addresses) if is_edge else [],
        "peers": [] if is_edge else encode_addresses(edges or {}),
        "detect": [_encode_detect(task.name, task.detect) for task in tasks.tasks.values() if task.detect],
    }


def encode_addresses(addresses: Mapping[str, str]) -> list[dict[str, str]]:
    """The links of a request; ``addresses`` of the robots, or of the edges, by name."""
    return [{"robot": name, "address": address} for name, address in addresses.items()]


def list_checked_tasks(tasks: Tasks, host: Host, *, elsewhere: bool = False) -> frozenset[str]:
    """Tasks whose ``done_when`` is checked on ``host``.

    ``elsewhere``: those whose check there counts for every host, because it is to run on their robot.
    """
    return frozenset(
        task.name
        for task in tasks.tasks.values()
        if task.done_when is not None
        and _can_check_done(task, host)
        and (not elsewhere or task.done_when.on is CheckLocation.ROBOT)
    )


def list_detected_tasks(tasks: Tasks) -> frozenset[str]:
    """Tasks that hosts look for by a rule."""
    return frozenset(task.name for task in tasks.tasks.values() if task.detect)


def _can_check_done(task: Task, host: Host) -> bool:
    """Whether ``done_when`` of ``task`` is checked on this host: any host it may run on, or its robot."""
    if task.done_when is None:
        return False
    if task.done_when.on is CheckLocation.ROBOT:
        return bool(task.robots) and host.name == task.robots[0]
    return host.role is Role.EDGE or host.name in task.robots


def _encode_detect(task: str, detect: DetectRule) -> dict[str, object]:
    return (
        {"task": task, "cmdline": detect.cmdline}
        if detect.cmdline is not None
        else {"task": task, "ros_node": detect.ros_node}
    )


def _encode_done_check(
    task: Task, check: Check, host: Host, inventory: Inventory, longest: float
) -> dict[str, object]:
    return {
        "task": task.name,
        **encode_question(check, host),
        "prelude": host.prelude,
        "ros": encode_ros(task, host, inventory.hosts),
        "env": drop_secrets(merge_environment(task, host, inventory.hosts)),
        "timeout_s": min(check.timeout, longest),
        "always": check.on is CheckLocation.ROBOT,
    }
