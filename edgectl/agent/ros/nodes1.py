# SPDX-License-Identifier: Apache-2.0
"""Nodes of a running graph of ROS 1, as the master and the nodes themselves state them."""

import time

from ..link.fast_json import Document
from . import graph1, local, xmlrpc
from .xmlrpc import CallError

# One node that hangs costs this much of the time for all.
_NODE_S = 1.0


def list_nodes(master: str, deadline: float) -> "list[Document]":
    """List the nodes; the master is one of them, without a name, where it runs on this host.

    ``pid`` is 0 where the process is not known, with the reason in ``fault``; ``here``: the node is one of
    this host.

    Raises:
        CallError: the master does not answer.
    """
    state = graph1.ask_master(master, "getSystemState", [], deadline)
    kinds = state if isinstance(state, list) and len(state) == 3 else [[], [], []]
    published, subscribed, offered = (_group_by_node(pairs) for pairs in kinds)
    names = sorted(set(published) | set(subscribed) | set(offered))
    nodes = [
        dict(
            _find_process(_look_up(name, master, deadline), deadline),
            name=name,
            publishes=sorted(published.get(name, [])),
            subscribes=sorted(subscribed.get(name, [])),
        )
        for name in names
    ]
    core = _find_process(master, deadline)
    return [*nodes, dict(core, name="", publishes=[], subscribes=[])] if core["here"] else nodes


def _group_by_node(pairs: "list[list[object]]") -> "dict[str, list[str]]":
    """Group the topics or services of ``[[topic, [node, ..]], ..]`` by node."""
    found: "dict[str, list[str]]" = {}
    for topic, nodes in pairs:
        for node in nodes if isinstance(nodes, list) else []:
            found.setdefault(str(node), []).append(str(topic))
    return found


def _look_up(name: str, master: str, deadline: float) -> str:
    try:
        return str(graph1.ask_master(master, "lookupNode", [name], deadline))
    except CallError:
        return ""


def _find_process(uri: str, deadline: float) -> Document:
    """Find the process that serves the API at ``uri``: asked of itself, and believed if it has the socket."""
    found = {"address": "", "here": False, "pid": 0, "fault": ""}
    try:
        host, port = xmlrpc.split_uri(uri)
        addresses = local.resolve_addresses([host])
        found["address"] = host
        found["here"] = bool(addresses) and local.is_own_address(addresses[0])
        if found["here"]:
            pid = xmlrpc.call_ros(uri, "getPid", [graph1.CALLER], min(deadline, time.monotonic() + _NODE_S))
            if isinstance(pid, int) and graph1.is_listening(pid, port):
                found["pid"] = pid
    except CallError as error:
        found["fault"] = "does not answer: %s" % error
    return found
