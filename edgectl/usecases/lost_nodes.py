# SPDX-License-Identifier: Apache-2.0
"""Removal of what ROS 1 nodes of lost instances have left at their master (ADR 0106)."""

import dataclasses

from edgectl.errors import HostError, StateError
from edgectl.executor.dependencies import is_replacement
from edgectl.executor.host_requests import build_forget_request
from edgectl.model.event import Event, EventKind
from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.result import Outcome, Results
from edgectl.rules.ros_nodes import LostNodes, describe_graph, get_master, list_lost_nodes
from edgectl.state.journal import Journal
from edgectl.transport.agent_client import ask_host
from edgectl.usecases.fleet import Fleet

_ASK_S = 15.0


def forget_lost_nodes(fleet: Fleet, plan: Plan, manager: ManagerState, results: Results) -> ManagerState:
    """Remove what nodes of lost instances have registered, and record it; ``manager`` without these nodes.

    What cannot be removed now is tried again by the next apply.
    """
    done = {result.task for result in results.actions if result.outcome is Outcome.DONE}
    replaced = {step.task for step in plan.steps if is_replacement(step) and step.task in done}
    placements = dict(manager.placements)
    for lost in list_lost_nodes(plan.snapshot, fleet.inventory, replaced):
        placement = placements.get(lost.task)
        if _forget(fleet, lost) and placement is not None and placement.host == lost.host:
            placements[lost.task] = dataclasses.replace(placement, nodes={})
    return dataclasses.replace(manager, placements=placements)


def _forget(fleet: Fleet, lost: LostNodes) -> bool:
    """Ask the host; whether nothing is left."""
    host = fleet.inventory.hosts[lost.asked]
    try:
        graph = _ask(fleet, host, lost).get("graph")
    except HostError as error:
        fleet.warn(f"nodes of {lost.task}, lost on {lost.host}, may be left in the graph: {error.message}")
        return False
    remarks = describe_graph(graph)
    if remarks:
        _record(fleet, lost, "; ".join(remarks))
    return not (isinstance(graph, dict) and graph.get("left"))


def _ask(fleet: Fleet, host: Host, lost: LostNodes) -> dict[str, object]:
    here = lost.asked == lost.host
    request = build_forget_request(
        host, task=lost.task if here else None, master=get_master(host) or "", nodes=lost.nodes
    )
    if fleet.lease is not None:
        request = {**request, "lease": fleet.lease.sign(host.name)}
    return ask_host(fleet.transport, host, request, timeout=_ASK_S, connect_timeout=_ASK_S)


def _record(fleet: Fleet, lost: LostNodes, message: str) -> None:
    """As an event and in the journal."""
    event = Event(
        at=fleet.clock(), kind=EventKind.NODES_REMOVED, host=lost.host, task=lost.task, message=message
    )
    fleet.history.use(fleet.state, fleet.warn, lambda store: store.record_events([event]))
    try:
        with Journal.open(fleet.state, clock=fleet.clock, warn=fleet.warn) as journal:
            journal.append("nodes", task=lost.task, host=lost.host, detail=message)
    except StateError as error:
        fleet.warn(error.message)
