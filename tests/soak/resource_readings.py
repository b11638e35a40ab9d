# SPDX-License-Identifier: Apache-2.0
"""Resource readings of a process, and growth between two of them."""

import ctypes
import gc
import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path

from tests.pace import patience

_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True, slots=True, kw_only=True)
class ResourceReading:
    """Resources of this process now. ``rss`` in MiB; ``remote``: processes on the hosts; ``objects``: tracked
    by the garbage collector.
    """

    rss: float
    files: int
    sockets: int
    threads: int
    objects: int
    remote: int = 0


# Tolerated growth after the warm-up: RSS is never quite constant, and the number of objects varies a little.
TOLERANCE = ResourceReading(rss=4.0, files=0, sockets=0, threads=0, objects=500, remote=0)


def take_reading(remote: Callable[[], int] = lambda: 0, *, settle_s: float = 5.0) -> ResourceReading:
    """Take a reading once ending threads have ended (at most ``settle_s``)."""
    gc.collect()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    deadline, before = time.monotonic() + patience(settle_s), (-1, -1)
    while (now := (_count_threads(), remote())) != before and time.monotonic() < deadline:
        before = now
        time.sleep(0.2)
    links = _list_open_files()
    return ResourceReading(
        rss=int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE / 2**20,
        files=len(links),
        sockets=sum(link.startswith("socket:") for link in links),
        threads=now[0],
        objects=len(gc.get_objects()),
        remote=now[1],
    )


def take_reading_at_rest(
    warm: ResourceReading, remote: Callable[[], int] = lambda: 0, *, patience_s: float = 30.0
) -> ResourceReading:
    """Take readings until none exceeds the ``warm`` one: what is about to end is no growth."""
    deadline = time.monotonic() + patience(patience_s)
    while list_growth(warm, found := take_reading(remote)) and time.monotonic() < deadline:
        time.sleep(0.2)
    return found


def _count_threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))


def _list_open_files() -> list[str]:
    found = []
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            found.append(str(entry.readlink()))
    return found


def list_growth(warm: ResourceReading, end: ResourceReading) -> list[str]:
    """List the resources that grew beyond their tolerance."""
    return [
        f"{each.name} {getattr(warm, each.name):g} -> {getattr(end, each.name):g}"
        for each in fields(ResourceReading)
        if getattr(end, each.name) > getattr(warm, each.name) + getattr(TOLERANCE, each.name)
    ]


def format_table(name: str, cycles: int, seconds: float, warm: ResourceReading, end: ResourceReading) -> str:
    """Format the readings of one part as a table."""
    lines = [
        f"{name}: {cycles} cycles in {seconds:.0f} s ({1000 * seconds / cycles:.1f} ms each)",
        f"{'':<10}{'warm':>10}{'end':>10}{'more':>10}",
    ]
    for each in fields(ResourceReading):
        one, other = getattr(warm, each.name), getattr(end, each.name)
        lines.append(f"{each.name:<10}{one:>10.6g}{other:>10.6g}{other - one:>+10.4g}")
    return "\n".join(lines) + "\n"
