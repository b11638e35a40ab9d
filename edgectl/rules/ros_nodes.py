# SPDX-License-Identifier: Apache-2.0
"""Names of the ROS nodes of stopped or lost instances, and what became of them (ADR 0106)."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

from edgectl.model.inventory import Host, Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import Snapshot
from edgectl.model.text import clean_text

# Of a list of names in a message, characters.
_MAX_NAMES = 300


@dataclass(frozen=True, slots=True, kw_only=True)
class LostNodes:
    """Nodes (name -> address) of an instance of ``task`` that certainly does not live on ``host`` any more.

    ``asked``: the host that can remove what they have registered; the same one where it answers.
    """

    task: str
    host: str
    nodes: Mapping[str, str]
    asked: str


def list_lost_nodes(
    snapshot: Snapshot, inventory: Inventory, replaced: Collection[str]
) -> Iterator[LostNodes]:
    """List the nodes of instances that are gone without a stop: their host answers and says so (it was
    rebooted), it is fenced, or they were ``replaced`` because of its silence.
    """
    manager = snapshot.manager or ManagerState()
    for host, sample in snapshot.hosts.items():
        for task, run in sample.tasks.items() if sample.ok else ():
            if run.managed and run.nodes and not run.state.alive:
                yield LostNodes(task=task, host=host, nodes=run.nodes, asked=host)
    for task, placement in manager.placements.items():
        there = snapshot.hosts.get(placement.host)
        gone = placement.host in manager.fenced or task in replaced
        if placement.nodes and gone and not (there is not None and there.ok):
            asked = _find_host_near_master(snapshot, inventory, placement.host)
            if asked is not None:
                yield LostNodes(task=task, host=placement.host, nodes=placement.nodes, asked=asked.name)


def _find_host_near_master(snapshot: Snapshot, inventory: Inventory, lost: str) -> Host | None:
    """The host that answers and has the master of the ``lost`` one, first the host of the master itself."""
    known = inventory.hosts.get(lost)
    wanted = known.ros.master if known is not None and known.ros is not None else None
    found = [
        host
        for name, sample in snapshot.hosts.items()
        if sample.ok
        and (host := inventory.hosts.get(name)) is not None
        and get_master(host) is not None
        and wanted in (None, get_master(host))
    ]
    return min(found, key=lambda host: urlsplit(get_master(host) or "").hostname != host.host, default=None)


def get_master(host: Host) -> str | None:
    """The URI of the ROS 1 master of a host; None where it states none."""
    return host.ros.master if host.ros is not None and host.ros.version == 1 else None


def describe_graph(graph: object) -> list[str]:
    """The remarks on what a host says of the names of the nodes that it has stopped; nothing where all said
    goodbye.
    """
    if not isinstance(graph, dict):
        return []
    removed, left = _join_names(graph.get("removed")), _join_names(graph.get("left"))
    why = clean_text(graph.get("why") or "", _MAX_NAMES)
    found = [f"unregistered {removed}"] if removed else []
    if left or why:
        found.append(
            " ".join(part for part in ("nodes left in the graph:", left, why and f"({why})") if part)
        )
    return found


def _join_names(names: object) -> str:
    return clean_text(", ".join(map(str, names)), _MAX_NAMES) if isinstance(names, Iterable) else ""
