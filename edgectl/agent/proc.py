"""Processes as the kernel shows them in /proc: read directly, because psutil costs several times as much for lists."""

import os
import time

TICKS = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")

_BLOCK = 1 << 16

# In module time since Python 3.7 only.
_CLOCK_BOOTTIME = 7


class Process:
    """One line of the process table.

    ``ticks``: start in clock ticks since boot, which with the pid names a process for as long as the host is up;
    ``cpu`` and ``child_cpu`` (of children that were waited for) in seconds; ``rss`` in bytes.
    """

    __slots__ = ("child_cpu", "cpu", "pid", "ppid", "rss", "sid", "state", "ticks")

    def __init__(self, pid: int, field: list) -> None:
        """``field``: what follows the name in /proc/PID/stat."""
        self.pid, self.ppid, self.sid = pid, int(field[1]), int(field[3])
        self.state, self.ticks = field[0].decode(), int(field[19])
        self.cpu = (int(field[11]) + int(field[12])) / TICKS
        self.child_cpu = (int(field[13]) + int(field[14])) / TICKS
        self.rss = int(field[21]) * PAGE


def read(path: str) -> bytes:
    """A file's content; empty where it is gone or closed to us. Two thirds of what ``open`` takes: whole process tables go through here."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return b""
    try:
        parts = [os.read(fd, _BLOCK)]
        while parts[-1]:
            parts.append(os.read(fd, _BLOCK))
        return b"".join(parts)
    except OSError:
        return b""
    finally:
        os.close(fd)


def process(pid: int):
    """One process, or None where it is gone."""
    head, _, tail = read("/proc/%d/stat" % pid).rpartition(b") ")
    return Process(pid, tail.split()) if head else None


def processes() -> dict:
    """Process by pid of everything visible that is not a zombie."""
    found = (process(int(name)) for name in os.listdir("/proc") if name.isdigit())
    return {each.pid: each for each in found if each is not None and each.state not in "ZX"}


def is_alive(pid: int, ticks: int) -> bool:
    """Whether the very process that was seen as (pid, ticks) still runs."""
    found = process(pid) if pid > 0 else None
    return found is not None and found.ticks == ticks and found.state not in "ZX"


def children(table: dict) -> dict:
    """Pids of its children by pid."""
    found = {}
    for each in table.values():
        found.setdefault(each.ppid, []).append(each.pid)
    return found


def descendants(pids: set, table: dict) -> set:
    """``pids`` and everything below them in ``table``."""
    below, found, todo = children(table), set(), [pid for pid in pids if pid in table]
    while todo:
        pid = todo.pop()
        if pid not in found:
            found.add(pid)
            todo += below.get(pid, ())
    return found


def environ_has(pid: int, entry: bytes) -> bool:
    """Whether ``NAME=value`` stands in the environment with which the process was started."""
    return b"\0" + entry + b"\0" in b"\0" + read("/proc/%d/environ" % pid) + b"\0"


def cmdline(pid: int) -> list:
    """The argument vector, decoded with replacement."""
    return [
        part.decode("utf-8", "replace") for part in read("/proc/%d/cmdline" % pid).rstrip(b"\0").split(b"\0")
    ]


def boot_id() -> str:
    """Changes with each boot of the host."""
    return read("/proc/sys/kernel/random/boot_id").decode().strip()


def uptime() -> float:
    """Seconds since boot, on the clock of start ticks (lxcfs shifts /proc/uptime, so that one is not read)."""
    return time.clock_gettime(_CLOCK_BOOTTIME)


def age(ticks: int) -> float:
    """Seconds since the process that carries ``ticks`` was started."""
    return max(0.0, uptime() - ticks / TICKS)
