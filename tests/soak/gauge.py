"""What a process holds, and whether it grew."""

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
class Reading:
    """This process now. ``rss`` in MiB; ``remote``: processes on the hosts; ``objects``: what the garbage collector knows."""

    rss: float
    files: int
    sockets: int
    threads: int
    objects: int
    remote: int = 0


# What may be more at the end than after warming up: RSS in MiB is never quite still, objects wander a little.
TOLERANCE = Reading(rss=4.0, files=0, sockets=0, threads=0, objects=500, remote=0)


def take(remote: Callable[[], int] = lambda: 0, *, settle_s: float = 5.0) -> Reading:
    """Read, once threads that are ending have ended (at most ``settle_s``)."""
    gc.collect()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    deadline, before = time.monotonic() + patience(settle_s), (-1, -1)
    while (now := (_threads(), remote())) != before and time.monotonic() < deadline:
        before = now
        time.sleep(0.2)
    links = _links()
    return Reading(
        rss=int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE / 2**20,
        files=len(links),
        sockets=sum(link.startswith("socket:") for link in links),
        threads=now[0],
        objects=len(gc.get_objects()),
        remote=now[1],
    )


def at_rest(warm: Reading, remote: Callable[[], int] = lambda: 0, *, patience_s: float = 30.0) -> Reading:
    """As `take`, again and again while there is more than when it was ``warm``: what is only on its way out is no growth."""
    deadline = time.monotonic() + patience(patience_s)
    while grown(warm, found := take(remote)) and time.monotonic() < deadline:
        time.sleep(0.2)
    return found


def _threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))


def _links() -> list[str]:
    found = []
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            found.append(str(entry.readlink()))
    return found


def grown(warm: Reading, end: Reading) -> list[str]:
    """What is more than it may be."""
    return [
        f"{each.name} {getattr(warm, each.name):g} -> {getattr(end, each.name):g}"
        for each in fields(Reading)
        if getattr(end, each.name) > getattr(warm, each.name) + getattr(TOLERANCE, each.name)
    ]


def table(name: str, cycles: int, seconds: float, warm: Reading, end: Reading) -> str:
    """The figures of one part, for people."""
    lines = [
        f"{name}: {cycles} cycles in {seconds:.0f} s ({1000 * seconds / cycles:.1f} ms each)",
        f"{'':<10}{'warm':>10}{'end':>10}{'more':>10}",
    ]
    for each in fields(Reading):
        one, other = getattr(warm, each.name), getattr(end, each.name)
        lines.append(f"{each.name:<10}{one:>10.6g}{other:>10.6g}{other - one:>+10.4g}")
    return "\n".join(lines) + "\n"
