"""The profiler that stays on a host: one sample per period into a ring in memory, from which a probe reads without waiting.

It measures as a probe does, over windows that follow each other without a gap. It never takes more than a hundredth of a core:
where a sample costs more than that share of its period, the period grows. It ends when no edgectl has called for ``ttl_s``, when
its seat is removed or taken by another, and by a plain signal; nothing is left of it then.
"""

import os
import time

try:
    import _signal as signal
except ImportError:
    import signal

from . import device, lease, light, network, proc, ring, seat, smooth
from .followed import Followed

_MOST_SHARE = 0.01
_LOOK_S = 2.0
# Routes, interface speeds, sensors and names change seldom, and nvidia-smi takes a tenth of a second.
_SLOW_S = 30.0


def resident(request: dict) -> None:
    """Operation ``profiler-run``: what the agent of a ``profiler-start`` asks of the process that it makes; never returns."""
    lock, report = int(request["lock"]), int(request["report"])
    try:
        for fd in (lock, report):
            os.set_inheritable(fd, False)
        null = os.open(os.devnull, os.O_RDWR)
        for fd in (0, 1, 2):
            os.dup2(null, fd)
        signal.signal(signal.SIGTERM, lambda *_: _go(request["folder"], lock, ""))
        fd = ring.create(request["folder"])
        known = seat.identity(fd)
        ring.describe(
            fd,
            dict(
                known,
                wishes=request["wishes"],
                every_s=request["every_s"],
                ttl_s=request["ttl_s"],
                begun=proc.uptime(),
            ),
        )
        seat.take(request["folder"], known)
        _tell(report, {"pid": known["pid"]})
        _go(request["folder"], lock, Resident(request, lock, fd).run())
    except Exception as error:  # noqa: BLE001 - there is nobody else left to tell
        words = "%s: %s" % (type(error).__name__, error)
        _tell(report, {"error": words})
        _go(request["folder"], lock, words)


def _go(folder: str, lock: int, why: str) -> None:
    """Note why and end, with the lock still held: nobody else sits here yet, unless the seat was made again."""
    if seat.is_mine(folder, lock):
        seat.leave(folder, why)
    os._exit(0)


def _tell(fd: int, document: dict) -> None:
    try:
        os.write(fd, light.dumps(document).encode("ascii"))
        os.close(fd)
    except OSError:
        pass


class Resident:
    """The loop. ``period``: seconds to the next sample, ``every`` unless samples cost too much."""

    def __init__(self, request: dict, lock: int, fd: int) -> None:
        self.host, self.folder, self.lock, self.ring = request["host"], request["folder"], lock, fd
        self.every, self.ttl = float(request["every_s"]), float(request["ttl_s"])
        self.period, self.links = self.every, request.get("links") or []
        self.tasks = Followed(self.host, request.get("detect") or [])
        self.addresses, self.traffic, self.rates, self.number = {}, None, None, 0
        self.cost, self.spent, self.begun, self.next_look = 0.0, time.process_time(), proc.uptime(), 0.0
        self._look_slowly()
        self.totals, self.since = network.interface_bytes(), time.monotonic()

    def run(self) -> str:
        """Until nobody wants it any more; returns why."""
        due, why = self.since + self.period, ""
        while not why:
            knocks = network.Knocks(self.addresses)
            knocks.wait(due)
            try:
                self._add(self._sample(knocks))
            except (OSError, ValueError, LookupError):
                # Memory is full, or a file of /proc went while it was read: this sample is missing, and probes measure for themselves.
                pass
            self._pace()
            # A machine that slept does not make up for what it missed.
            due = max(due, time.monotonic() - self.period) + self.period
            why = self._why_end()
        return why

    def _why_end(self) -> str:
        if not seat.is_mine(self.folder, self.lock):
            return "its directory was removed"
        if time.monotonic() < self.next_look:
            return ""
        self.next_look = time.monotonic() + min(_LOOK_S, self.ttl / 2)
        silent_s = proc.uptime() - max(self.begun, lease.last(self.host))
        return "" if silent_s < self.ttl else "no edgectl called for %g s" % self.ttl

    def _pace(self) -> None:
        spent = time.process_time()
        self.cost += 0.1 * (spent - self.spent - self.cost)
        self.spent = spent
        self.period = max(self.every, self.cost / _MOST_SHARE)

    def _sample(self, knocks) -> dict:
        now = time.monotonic()
        seconds, self.since = max(1e-3, now - self.since), now
        cpu, flows = self.cpu.reading(), self.traffic.flows()
        before, self.totals = self.totals, network.interface_bytes()
        knocks.close(self.addresses)
        tasks, used = self.tasks.reading(flows, self.addresses, seconds)
        links = network.links(self.addresses, flows, knocks, seconds, self.slow["ways"])
        raw = {
            "cpu": cpu["used_cores"] - sum(each["used_cores"] for each in tasks.values()),
            "interfaces": network.rates(before, self.totals, seconds),
            "links": {robot: _remaining(robot, link, tasks) for robot, link in links.items()},
            "tasks": tasks,
        }
        self.rates = smooth.smoothed(self.rates, raw, smooth.weight(seconds, self.every))
        levels = dict(
            self.slow,
            cores=cpu["cores"],
            bytes=used,
            reachable={robot: link["reachable"] for robot, link in links.items()},
        )
        return {
            "at": proc.uptime(),
            "period_s": self.period,
            "raw": raw,
            "rates": self.rates,
            "levels": levels,
            "addresses": self.addresses,
        }

    def _add(self, sample: dict) -> None:
        ring.add(self.ring, self.number + 1, sample)
        self.number += 1
        if time.monotonic() >= self.next_slow:
            self._look_slowly()

    def _look_slowly(self) -> None:
        addresses = network.resolve(self.links)
        if self.traffic is None or addresses != self.addresses:
            if self.traffic is not None:
                self.traffic.close()
            self.addresses, self.traffic = addresses, network.Traffic(addresses)
        self.slow = {
            "ways": network.ways(addresses),
            "speeds": {name: network.speed(name) for name in network.interface_bytes()},
            "temperature_c": device.temperature_c(None),
            "gpu_share": device.gpu_share(),
        }
        # Limits of the control group may have changed.
        self.cpu = device.CpuMeter()
        self.next_slow = time.monotonic() + _SLOW_S


def _remaining(robot: str, link: dict, tasks: dict) -> dict:
    """What no task moves: a task that ends takes its own with it at once, however slowly the rest is forgotten."""
    own = [each["robots"][robot] for each in tasks.values() if robot in each["robots"]]
    return {
        "rx": link["rx_bytes_per_s"] - sum(each["rx"] for each in own),
        "tx": link["tx_bytes_per_s"] - sum(each["tx"] for each in own),
        "rtt_ms": link["rtt_ms"],
    }
