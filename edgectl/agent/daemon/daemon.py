# SPDX-License-Identifier: Apache-2.0
"""Resident profiler: one sample per period into a ring in memory, from which a probe reads without a sample
window.

It measures as a probe does, over contiguous windows. It uses at most a hundredth of a core: where a sample
costs more than that share of its period, the period grows. It ends when no request came for ``ttl_s``, when
its directory is removed or taken by another profiler, and by SIGTERM; nothing of it is left then.
"""

import _signal as signal
import os
import time

from ..link import fast_json, heartbeat
from ..link.fast_json import Document
from ..measure import device, interfaces, network, proc
from ..measure.udp import UdpMeter
from ..supervise import state_dir
from . import pidfile, sample_ring
from .process_tracker import ProcessTracker

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, NoReturn

    from ..measure.counters import CounterMeter

_MAX_CPU_SHARE = 0.01
_CHECK_S = 2.0
# Routes, interface speeds, sensors and names change rarely, and nvidia-smi takes 0.1 s.
_SLOW_S = 30.0
# Weight of a reading that covers one nominal period.
ALPHA = 0.3


def run_profiler(request: Document) -> "NoReturn":
    """Operation ``profiler-run``: the request of ``profiler-start`` to the process that it launches."""
    lock, report = int(request["lock"]), int(request["report"])
    try:
        for fd in (lock, report):
            os.set_inheritable(fd, False)
        null = os.open(os.devnull, os.O_RDWR)
        for fd in (0, 1, 2):
            os.dup2(null, fd)
        signal.signal(signal.SIGTERM, lambda *_: _exit_profiler(request["folder"], lock, ""))
        fd = sample_ring.create_ring(request["folder"])
        known = pidfile.build_identity(fd)
        sample_ring.write_description(
            fd,
            dict(
                known,
                probe_spec=request["probe_spec"],
                every_s=request["every_s"],
                ttl_s=request["ttl_s"],
                begun=proc.read_uptime_s(),
            ),
        )
        pidfile.write_pidfile(request["folder"], known)
        fast_json.send_document(report, {"pid": known["pid"]})
        _exit_profiler(request["folder"], lock, ProfilerDaemon(request, lock, fd).run())
    except Exception as error:  # noqa: BLE001 - the report is the only channel left
        reason = "%s: %s" % (type(error).__name__, error)
        fast_json.send_document(report, {"error": reason})
        _exit_profiler(request["folder"], lock, reason)


def _exit_profiler(folder: str, lock: int, why: str) -> "NoReturn":
    """Record the reason and exit with the lock still held; not where the directory was created again."""
    if pidfile.is_own_lock(folder, lock):
        pidfile.write_end(folder, why)
    os._exit(0)


class ProfilerDaemon:
    """The sampling loop. ``period``: seconds to the next sample, ``every`` unless samples cost too much."""

    def __init__(self, request: Document, lock: int, fd: int) -> None:
        self.host, self.folder, self.lock, self.ring = request["host"], request["folder"], lock, fd
        self.every, self.ttl = float(request["every_s"]), float(request["ttl_s"])
        self.period, self.links = self.every, request.get("links") or []
        self.peer_links = request.get("peers") or []
        self.tasks = ProcessTracker(self.host, request.get("detect") or [])
        self.addresses = network.resolve_robots(self.links)
        self.peers = network.resolve_robots(self.peer_links)
        self.traffic = network.TrafficMeter(dict(self.addresses, **self.peers))
        self.udp = UdpMeter(self.traffic.counters)
        self.counted: "CounterMeter | None" = None
        self.wireless = interfaces.start_radio_meter()
        self.hardware = device.start_hardware_meter()
        self.rates: "Document | None" = None
        self.number = 0
        self.cost, self.spent, self.begun, self.next_look = (
            0.0,
            time.process_time(),
            proc.read_uptime_s(),
            0.0,
        )
        self._refresh_slow_values(self.addresses, self.peers)
        self.totals, self.since = interfaces.read_interface_bytes(), time.monotonic()

    def run(self) -> str:
        """Run until the end; returns its reason."""
        due, why = self.since + self.period, ""
        while not why:
            probes = network.ConnectProbes(self.addresses)
            probes.wait(due)
            try:
                self._store_sample(self._take_sample(probes))
            except (OSError, ValueError, LookupError):
                # Memory is full, or a process ended while its files were read: without this sample a probe
                # measures by itself.
                pass
            self._adjust_period()
            # After a suspension the missed samples are not made up for.
            due = max(due, time.monotonic() - self.period) + self.period
            why = self._find_end_reason()
        return why

    def _find_end_reason(self) -> str:
        if not pidfile.is_own_lock(self.folder, self.lock):
            return "its directory was removed"
        if time.monotonic() < self.next_look:
            return ""
        self.next_look = time.monotonic() + min(_CHECK_S, self.ttl / 2)
        silent_s = proc.read_uptime_s() - max(self.begun, heartbeat.read_last_heartbeat(self.host))
        return "" if silent_s < self.ttl else "no edgectl called for %g s" % self.ttl

    def _adjust_period(self) -> None:
        spent = time.process_time()
        self.cost += 0.1 * (spent - self.spent - self.cost)
        self.spent = spent
        self.period = max(self.every, self.cost / _MAX_CPU_SHARE)

    def _take_sample(self, probes: network.ConnectProbes) -> Document:
        now = time.monotonic()
        seconds, self.since = max(1e-3, now - self.since), now
        cpu, flows = self.cpu.measure(), self.traffic.flows(probes.opened)
        before, self.totals = self.totals, interfaces.read_interface_bytes()
        probes.close(self.addresses)
        udp = self.udp.find_sockets(self.traffic.counters)
        counted = (
            None if self.counted is None else self.counted.measure_rarely(self.addresses, self.slow["routes"])
        )
        tasks, used = self.tasks.measure(flows, self.addresses, seconds, counted)
        links = network.build_links(
            self.addresses, flows, probes, self.traffic.seconds, self.slow["routes"], udp, counted
        )
        raw = {
            "cpu": cpu["used_cores"] - sum(each["used_cores"] for each in tasks.values()),
            "interfaces": interfaces.compute_rates(before, self.totals, seconds),
            "links": {robot: _subtract_tasks(robot, link, tasks) for robot, link in links.items()},
            "tasks": tasks,
        }
        self.rates = smooth_values(self.rates, raw, compute_weight(seconds, self.every))
        levels = dict(
            self.slow,
            cores=cpu["cores"],
            bytes=used,
            reachable={robot: link["reachable"] for robot, link in links.items()},
            carries={robot: link["carries_bytes_per_s"] for robot, link in links.items()},
            radios={robot: link["radio_bytes_per_s"] for robot, link in links.items()},
            partial_links={robot: link["partial"] for robot, link in links.items()},
            partial_tasks=self.tasks.describe_gaps(udp, self.addresses, counted),
            sources={robot: link["source"] for robot, link in links.items()},
            counters="" if counted is None else counted.state,
            peers=network.build_peers(self.peers, flows, self.traffic.seconds),
        )
        return {
            "at": proc.read_uptime_s(),
            "period_s": self.period,
            "raw": raw,
            "rates": self.rates,
            "levels": levels,
            "addresses": self.addresses,
        }

    def _store_sample(self, sample: Document) -> None:
        sample_ring.write_sample(self.ring, self.number + 1, sample)
        self.number += 1
        if time.monotonic() >= self.next_slow:
            self._refresh_slow_values(
                network.resolve_robots(self.links), network.resolve_robots(self.peer_links)
            )

    def _refresh_slow_values(self, addresses: "network.Addresses", peers: "network.Addresses") -> None:
        if (addresses, peers) != (self.addresses, self.peers):
            self.traffic.close()
            self.addresses, self.peers = addresses, peers
            self.traffic = network.TrafficMeter(dict(addresses, **peers))
        self.slow: Document = {
            "routes": network.find_interfaces(addresses),
            "speeds": {
                name: interfaces.read_interface_speed(name) for name in interfaces.read_interface_bytes()
            },
            "wireless": {} if self.wireless is None else self.wireless.measure(),
            "temperature_c": device.read_temperature_c(),
            "hardware": device.measure_hardware(self.hardware),
        }
        self.counted = self.counted or network.start_counter_meter(state_dir.get_fleet(), addresses)
        # Limits of the control group may have changed.
        self.cpu = device.CpuMeter()
        self.next_slow = time.monotonic() + _SLOW_S


def _subtract_tasks(robot: str, link: Document, tasks: "dict[str, Document]") -> Document:
    """Subtract the tasks' traffic: the traffic of a task that ends is gone at once, however slowly the rest
    is smoothed.
    """
    own = [each["robots"][robot] for each in tasks.values() if robot in each["robots"]]
    return {
        "rx": link["rx_bytes_per_s"] - sum(each["rx"] for each in own),
        "tx": link["tx_bytes_per_s"] - sum(each["tx"] for each in own),
        "other": link.get("other_bytes_per_s", 0.0),
        "rtt_ms": link["rtt_ms"],
    }


def compute_weight(seconds: float, period: float) -> float:
    """Compute the weight of a reading over ``seconds``: ALPHA for one nominal ``period``.

    Two halves weigh as much as one whole.
    """
    return float(1.0 - (1.0 - ALPHA) ** (seconds / period))


def smooth_values(old: "Any", new: "Any", share: float) -> "Any":
    """Smooth every number of ``new`` by ``share`` of the way from ``old``.

    Numbers that ``old`` lacks are taken as they are.
    """
    if isinstance(new, dict):
        before = old if isinstance(old, dict) else {}
        return {name: smooth_values(before.get(name), value, share) for name, value in new.items()}
    if new is None or old is None:
        return new
    return old + share * (new - old)
