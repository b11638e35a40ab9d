# SPDX-License-Identifier: Apache-2.0
"""Cables between two network namespaces, with delay, loss and a rate: packets pass through this process (root).

The kernel need not have netem. What is lost are packets, so TCP repeats them as on a real line.
"""

import fcntl
import heapq
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from tests.faults.hosts import wait_for
from tests.faults.network import run_ip
from tests.faults.relay import enter_netns

Found = TypeVar("Found")
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_PACKET_BYTES = 65536
# What waits for its turn on a slow line; later packets are lost, as in any router.
_QUEUE_S = 0.5


@dataclass(frozen=True, kw_only=True)
class Line:
    """``delay_s`` each way; ``loss``: share of the packets, each way; ``bits_per_s``: 0 for as fast as may be."""

    delay_s: float = 0.0
    loss: float = 0.0
    bits_per_s: float = 0.0


@dataclass(eq=False)
class Way:
    """One direction of a cable. ``free_at``: when the line has sent what came before."""

    source: int
    sink: int
    free_at: float = 0.0
    passed_bytes: int = 0


@dataclass(eq=False)
class Cables:
    """Cables of one ``line``, and the thread that passes packets on."""

    line: Line = field(default_factory=Line)
    ways: list[Way] = field(default_factory=list)
    ending: bool = False

    def add(self, one: Path, other: Path, number: int) -> None:
        """Connect two network namespaces: 10.234.NUMBER.1 is in the first, .2 in the second."""
        fds = [run_in_netns(netns, lambda: open_tun(f"tun{number}")) for netns in (one, other)]
        for netns, addresses in ((one, ("1", "2")), (other, ("2", "1"))):
            mine, theirs = (f"10.234.{number}.{last}" for last in addresses)
            pid = int(netns.parts[2])
            run_ip(*f"addr add {mine} peer {theirs} dev tun{number}".split(), netns=pid)
            run_ip(*f"link set tun{number} up".split(), netns=pid)
        self.ways += [Way(*fds), Way(*reversed(fds))]

    def run(self) -> None:
        """Pass packets on until ``ending``."""
        by_source = {way.source: way for way in self.ways}
        draw, count = random.Random(1), 0
        due: list[tuple[float, int, int, bytes]] = []
        while not self.ending:
            wait_s = min(0.1, due[0][0] - time.monotonic()) if due else 0.1
            for source in select.select(list(by_source), [], [], max(0.0, wait_s))[0]:
                way, packet, now = by_source[source], os.read(source, _PACKET_BYTES), time.monotonic()
                line = self.line
                way.passed_bytes += len(packet)
                begins = max(now, way.free_at)
                if draw.random() < line.loss or begins - now > _QUEUE_S:
                    continue
                way.free_at = begins + (8 * len(packet) / line.bits_per_s if line.bits_per_s else 0.0)
                count += 1
                heapq.heappush(due, (way.free_at + line.delay_s, count, way.sink, packet))
            while due and due[0][0] <= time.monotonic():
                _, _, sink, packet = heapq.heappop(due)
                os.write(sink, packet)

    def close(self) -> None:
        """Close the ends of all cables."""
        for way in self.ways:
            os.close(way.source)


def open_tun(name: str) -> int:
    """Make an interface of this thread's network namespace."""
    fd = os.open("/dev/net/tun", os.O_RDWR | os.O_CLOEXEC)
    fcntl.ioctl(fd, _TUNSETIFF, struct.pack("16sH", name.encode(), _IFF_TUN | _IFF_NO_PI))
    return fd


def run_in_netns(netns: Path, work: Callable[[], Found]) -> Found:
    """Do ``work`` in a thread that has entered a network namespace; processes that it starts are there too."""
    found: list[Found] = []

    def enter_and_work() -> None:
        enter_netns(netns)
        found.append(work())

    thread = threading.Thread(target=enter_and_work)
    thread.start()
    thread.join()
    assert found, f"failed in {netns}"
    return found[0]


@contextmanager
def network_namespace() -> Iterator[Path]:
    """A network namespace, which ends with its process."""
    own = Path("/proc/self/ns/net").readlink()
    process = subprocess.Popen(["unshare", "--net", "cat"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    assert process.stdin is not None
    try:
        netns = Path(f"/proc/{process.pid}/ns/net")
        wait_for(lambda: netns.readlink() != own, "a network namespace")
        run_ip("link", "set", "lo", "up", netns=process.pid)
        yield netns
    finally:
        process.stdin.close()
        process.wait(60)


@contextmanager
def run_cables(count: int) -> Iterator[tuple[Path, Path, Cables]]:
    """Namespaces of a manager and of its hosts, with ``count`` cables, and a thread that passes packets on."""
    with ExitStack() as stack:
        manager, hosts = stack.enter_context(network_namespace()), stack.enter_context(network_namespace())
        cables = Cables()
        for number in range(count):
            cables.add(manager, hosts, number)
        stack.callback(cables.close)
        thread = threading.Thread(target=cables.run, daemon=True)
        thread.start()
        try:
            yield manager, hosts, cables
        finally:
            cables.ending = True
            thread.join(10)
