# SPDX-License-Identifier: Apache-2.0
"""Import of running ROS graphs: nodes that edgectl did not start become unmanaged tasks."""

from collections.abc import Sequence

from edgectl.errors import HostError, UsageError
from edgectl.gateway.ros_graph import read_ros_graphs
from edgectl.importers.ros_live import build_live_tasks
from edgectl.importers.yaml_text import render_file
from edgectl.model.inventory import Host
from edgectl.model.ros import RosGraph
from edgectl.names import check_known_names
from edgectl.rules.environment import merge_host_environment
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import track_heartbeats
from edgectl.usecases.import_result import Imported


def import_live(fleet: Fleet, names: Sequence[str], *, timeout: float) -> Imported:
    """Make tasks of the nodes that run on the hosts ``names``, as their graphs show them now.

    Nothing is started but, for ROS 2, a helper on the host, which ends by itself. A host that does not answer
    is an error: a file without its nodes would look complete. Without a new node there is no task file.

    Raises:
        UsageError: a host is unknown, or nothing says which graph is its own.
        HostError: a host, or its graph, does not answer.
    """
    check_known_names(names, fleet.inventory.hosts, "host")
    hosts = [fleet.inventory.hosts[name] for name in dict.fromkeys(names)]
    for host in hosts:
        _check_ros(host)
    with track_heartbeats(fleet) as near:
        answers = read_ros_graphs(fleet.inventory, hosts, near.transport, timeout=timeout)
    graphs: dict[str, RosGraph] = {}
    for host in hosts:
        answer = answers[host.name]
        if isinstance(answer, HostError):
            raise answer
        graphs[host.name] = answer
    robots = [robot.name for robot in fleet.inventory.robots]
    file, notes = build_live_tasks(graphs, fleet.inventory.fleet, robots, fleet.tasks.tasks)
    tasks = render_file(file) if file.sections["tasks"] else ""
    return Imported(name=f"live-{hosts[0].name}", inventory="", tasks=tasks, notes=notes)


def _check_ros(host: Host) -> None:
    """Check that the graph of a host is stated."""
    if not host.probe:
        raise UsageError(f"{host.name} has probe: false", hint="name a host that edgectl can reach")
    stated = merge_host_environment(host)
    if (host.ros is None or host.ros.version == 1) and "ROS_MASTER_URI" not in stated:
        raise UsageError(
            f"no ROS graph is stated for {host.name}",
            hint="state ros: {version: 1, master: ..} or ros: {version: 2} in the inventory",
        )
