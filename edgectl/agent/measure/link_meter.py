# SPDX-License-Identifier: Apache-2.0
"""Meter of what passes between this host and robots, and over the sockets of tasks.

A module of its own: a host without robots and tasks has nothing to measure by it, and it costs a third of
such a probe.
"""

from ..link.fast_json import Document
from ..supervise import state_dir
from . import network
from .task_meter import TaskMeter, Traffic
from .udp import UdpMeter


class LinkMeter:
    """Meter of links and connections since ``begin`` or its last measurement."""

    def __init__(self, request: Document) -> None:
        """Look up the names of the robots, which may take seconds."""
        self._addresses = network.resolve_robots(request.get("links", []))
        self._peers = network.resolve_robots(request.get("peers", []))

    def begin(self) -> None:
        """Measure from now on."""
        self._counted = network.start_counter_meter(state_dir.get_fleet(), self._addresses)
        self._traffic = network.TrafficMeter(dict(self._addresses, **self._peers))
        self._udp = UdpMeter(self._traffic.counters)

    def start_probes(self) -> network.ConnectProbes:
        """Connect to each robot once, for the round-trip time."""
        return network.ConnectProbes(self._addresses)

    def measure(self, probes: network.ConnectProbes, tasks: TaskMeter, seconds: float) -> Document:
        """Measure links and tasks: parts of the reply to a probe."""
        addresses, flows = self._addresses, self._traffic.flows(probes.opened)
        interfaces = network.find_interfaces(addresses)
        datagrams = self._udp.find_sockets(self._traffic.counters)
        counted = None if self._counted is None else self._counted.measure(addresses, interfaces)
        measured = tasks.measure(Traffic(flows, datagrams, addresses, counted), seconds)
        probes.close(addresses)
        window_s = self._traffic.seconds
        return {
            "links": network.build_links(addresses, flows, probes, window_s, interfaces, datagrams, counted),
            "counters": "" if counted is None else counted.state,
            "peers": network.build_peers(self._peers, flows, window_s),
            "tasks": measured,
        }

    def close(self) -> None:
        """Listen no longer for connections that are closed."""
        self._traffic.close()
