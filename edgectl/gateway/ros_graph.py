# SPDX-License-Identifier: Apache-2.0
"""Running ROS graphs, asked of hosts."""

from collections.abc import Sequence

from edgectl.agent.link import protocol
from edgectl.errors import HostError, ReplyError
from edgectl.gateway.fanout import HostReply, ask_all
from edgectl.gateway.replies import decode_reply
from edgectl.model.inventory import Host, Inventory
from edgectl.model.ros import RosGraph
from edgectl.rules.environment import drop_secrets, merge_host_environment
from edgectl.rules.ros import encode_host_ros
from edgectl.transport.base import Transport

# Of the time of a request, what the host has for the graph itself.
_GRAPH_SHARE = 0.8


def read_ros_graphs(
    inventory: Inventory, hosts: Sequence[Host], transport: Transport, *, timeout: float
) -> dict[str, RosGraph | HostError]:
    """The graph as each of ``hosts`` sees it, or its error; ``timeout`` s for each."""
    robots = [robot.host for robot in inventory.robots]

    def build(host: Host, left: float) -> dict[str, object]:
        return build_graph_request(host, robots, timeout_s=left * _GRAPH_SHARE)

    return {
        answer.host.name: answer.value
        for answer in ask_all(hosts, transport, build, decode_graph, timeout=timeout)
    }


def build_graph_request(host: Host, robots: Sequence[str], *, timeout_s: float) -> dict[str, object]:
    """Request for the nodes of the graph; ``robots``: the addresses that nodes of the host must reach."""
    return {
        "op": protocol.OP_GRAPH,
        "fleet": host.fleet,
        "host": host.name,
        "version": host.ros.version if host.ros is not None else 1,
        "ros": encode_host_ros(host, robots),
        # As in requests for tasks, so that they share one helper for ROS 2.
        "env": {**drop_secrets(merge_host_environment(host)), "EDGECTL_HOST": host.name},
        "timeout_s": timeout_s,
    }


def decode_graph(reply: HostReply) -> RosGraph:
    """The graph in a reply.

    Raises:
        ReplyError: a value is missing or of the wrong type, or the document is of another host.
    """
    document = reply.document
    if document.get("op") != protocol.OP_GRAPH or document.get("host") != reply.host.name:
        raise ReplyError("not a reply of this host to a question for the ROS graph")
    return decode_reply(RosGraph, document)
