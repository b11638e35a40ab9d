"""Measure what a link carries by really sending over it, for a bounded time, one link after the other."""

from collections.abc import Iterator

from edgectl.errors import HostError, ReplyError
from edgectl.gateway.fields import positive, text, whole
from edgectl.model.bandwidth import Measurement
from edgectl.model.inventory import Host, Inventory
from edgectl.transport.base import Transport
from edgectl.transport.call import call

_CONNECT_S = 15.0
_MARGIN_S = 10.0


def measure(inventory: Inventory, transport: Transport, *, seconds: float) -> Iterator[Measurement]:
    """Measure each edge-robot link in turn, so that no measurement disturbs another; robots with ``probe: false`` are left out."""
    for edge in inventory.edges:
        for robot in inventory.robots:
            if robot.probe:
                yield _measured(edge, robot, transport, seconds)


def _measured(edge: Host, robot: Host, transport: Transport, seconds: float) -> Measurement:
    try:
        return Measurement(edge=edge.name, robot=robot.name, bytes_per_s=_sent(edge, robot, transport, seconds))
    except HostError as error:
        return Measurement(edge=edge.name, robot=robot.name, bytes_per_s=None, error=error.message)


def _sent(edge: Host, robot: Host, transport: Transport, seconds: float) -> float:
    """Receive on the robot, send from the edge."""
    timeout = seconds + _MARGIN_S
    with transport.connect(robot, timeout=_CONNECT_S) as session:
        sink = call(session, {"op": "sink", "host": robot.name, "seconds": seconds}, timeout=timeout)
    request = {"op": "send", "host": edge.name, "address": transport.address(robot), "seconds": seconds}
    with transport.connect(edge, timeout=_CONNECT_S) as session:
        sent = call(session, {**request, "port": whole(sink, "port", low=1), "token": text(sink, "token")}, timeout=timeout)
    carried, took = positive(sent, "bytes"), positive(sent, "seconds")
    if took > timeout:
        raise ReplyError(f"sent for {took:g} s, asked for {seconds:g} s")
    return carried / took
