"""Measurement of link bandwidth by sending data for a bounded time, one link after the other."""

from collections.abc import Iterator

from edgectl.agent.link import protocol
from edgectl.errors import HostError, ReplyError
from edgectl.gateway.replies import SendReply, SinkReply, decode_reply
from edgectl.model.inventory import Host, Inventory
from edgectl.model.snapshot import BandwidthMeasurement
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Transport

_CONNECT_S = 15.0
_MARGIN_S = 10.0


def measure_bandwidth(
    inventory: Inventory, transport: Transport, *, seconds: float
) -> Iterator[BandwidthMeasurement]:
    """Measure each edge-robot link in turn; robots with ``probe: false`` are left out."""
    for edge in inventory.edges:
        for robot in inventory.robots:
            if robot.probe:
                yield _measure_link(edge, robot, transport, seconds)


def _measure_link(edge: Host, robot: Host, transport: Transport, seconds: float) -> BandwidthMeasurement:
    try:
        return BandwidthMeasurement(
            edge=edge.name, robot=robot.name, bytes_per_s=_measure_throughput(edge, robot, transport, seconds)
        )
    except HostError as error:
        return BandwidthMeasurement(edge=edge.name, robot=robot.name, bytes_per_s=None, error=error.message)


def _measure_throughput(edge: Host, robot: Host, transport: Transport, seconds: float) -> float:
    """Receive on the robot, send from the edge."""
    timeout = seconds + _MARGIN_S
    with transport.connect(robot, timeout=_CONNECT_S) as session:
        sink = call_agent(
            session,
            {"op": protocol.OP_SINK, "fleet": robot.fleet, "host": robot.name, "seconds": seconds},
            timeout=timeout,
        )
    receiver = decode_reply(SinkReply, sink)
    request = {
        "op": protocol.OP_SEND,
        "fleet": edge.fleet,
        "host": edge.name,
        "address": transport.address(robot),
        "seconds": seconds,
    }
    with transport.connect(edge, timeout=_CONNECT_S) as session:
        sent = call_agent(
            session,
            {**request, "port": receiver.port, "token": receiver.token},
            timeout=timeout,
        )
    reply = decode_reply(SendReply, sent)
    if reply.seconds > timeout:
        raise ReplyError(f"sent for {reply.seconds:g} s, asked for {seconds:g} s")
    return reply.bytes / reply.seconds
