# SPDX-License-Identifier: Apache-2.0
"""Measurement of link bandwidth by sending data for a bounded time, one link after the other."""

from collections.abc import Iterator, Mapping

from edgectl.agent.link import protocol
from edgectl.errors import HostError, ReplyError
from edgectl.gateway.fanout import fan_out
from edgectl.gateway.replies import SampleReply, SendReply, SinkReply, decode_reply
from edgectl.model.inventory import Host, Inventory
from edgectl.model.link_reading import LinkSampleResult
from edgectl.model.snapshot import BandwidthMeasurement
from edgectl.rules.link_turns import MAX_SAMPLE_BYTES_PER_S
from edgectl.rules.live_links import SAMPLE_S
from edgectl.transport.agent_client import call_agent
from edgectl.transport.base import Transport

_CONNECT_S = 15.0
_MARGIN_S = 10.0
# Of a probe of an idle link, which must not hold up a plan.
_PROBE_S = 3.0


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
            _build_sink_request(robot, seconds),
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


def probe_idle_links(
    inventory: Inventory, transport: Transport, rates: Mapping[tuple[str, str], float]
) -> dict[tuple[str, str], LinkSampleResult]:
    """Send over each of these links, which have no host in common, for at most 0.1 s; all at once.

    ``rates``: bytes/s to send at most, by (edge, robot). A link that cannot be probed has no rate.
    """
    pairs = list(rates)
    found = fan_out(
        lambda pair: _probe_idle_link(
            inventory.hosts[pair[0]], inventory.hosts[pair[1]], transport, rates[pair]
        ),
        pairs,
        workers=max(1, len(pairs)),
    )
    return {pairs[position]: result for position, result in found}


def _probe_idle_link(edge: Host, robot: Host, transport: Transport, rate: float) -> LinkSampleResult:
    try:
        with transport.connect(robot, timeout=_PROBE_S) as session:
            sink = call_agent(session, _build_sink_request(robot, SAMPLE_S), timeout=_PROBE_S)
        receiver = decode_reply(SinkReply, sink)
        request = {
            "op": protocol.OP_SAMPLE_LINK,
            "fleet": edge.fleet,
            "host": edge.name,
            "address": transport.address(robot),
            "port": receiver.port,
            "token": receiver.token,
            "seconds": SAMPLE_S,
            "rate_bytes_per_s": min(rate, MAX_SAMPLE_BYTES_PER_S),
        }
        with transport.connect(edge, timeout=_PROBE_S) as session:
            reply = decode_reply(SampleReply, call_agent(session, request, timeout=_PROBE_S))
    except HostError:
        return LinkSampleResult(refused=True)
    return LinkSampleResult(bytes_per_s=reply.bytes_per_s, full=reply.full)


def _build_sink_request(robot: Host, seconds: float) -> dict[str, object]:
    return {"op": protocol.OP_SINK, "fleet": robot.fleet, "host": robot.name, "seconds": seconds}
