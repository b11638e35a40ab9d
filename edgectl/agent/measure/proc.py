# SPDX-License-Identifier: Apache-2.0
"""Process table and clock, read directly from /proc: psutil costs several times as much for lists."""

import os
import time

from .system_files import TICKS_PER_S, read_file

PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")

# CLOCK_BOOTTIME, which module time has since Python 3.7.
_CLOCK_BOOTTIME = 7
# CPUCLOCK_SCHED in the number of the CPU clock of a process, clock_getcpuclockid(3).
_CPU_CLOCK = 2


class Process:
    """One process, as /proc/PID/stat shows it.

    ``ticks``: start in clock ticks since boot, which with the pid identifies a process for as long as the
    host is up; ``cpu`` and ``child_cpu`` (of children that were waited for) in seconds; ``rss`` in bytes.
    """

    __slots__ = ("child_cpu", "cpu", "pid", "ppid", "rss", "sid", "state", "ticks")

    def __init__(self, pid: int, field: "list[bytes]") -> None:
        """``field``: the columns after the name in /proc/PID/stat."""
        self.pid, self.ppid, self.sid = pid, int(field[1]), int(field[3])
        self.state, self.ticks = field[0].decode(), int(field[19])
        self.cpu = (int(field[11]) + int(field[12])) / TICKS_PER_S
        self.child_cpu = (int(field[13]) + int(field[14])) / TICKS_PER_S
        self.rss = int(field[21]) * PAGE_BYTES


def read_network_counters() -> bytes:
    """Read what this network namespace has counted of IPv4, TCP and UDP since boot."""
    return read_file("/proc/net/snmp")


def find_counters(counters: bytes, protocol: bytes) -> "dict[bytes, bytes]":
    """Find name -> number of a ``protocol`` (b"Tcp") in ``read_network_counters``."""
    rows = [row.split() for row in counters.splitlines() if row.startswith(protocol + b":")]
    return dict(zip(*rows)) if len(rows) == 2 else {}  # noqa: B905 - Python 3.6


def read_process(pid: int) -> "Process | None":
    """Read one process; None where it is gone."""
    head, _, tail = read_file("/proc/%d/stat" % pid).rpartition(b") ")
    # Most of the 50 columns are not needed.
    return Process(pid, tail.split(None, 22)) if head else None


def read_cpu_s(process: Process) -> float:
    """Read the CPU seconds of all threads of a process, those that have ended too, in ns.

    /proc/PID/stat has them in ticks of 10 ms, too coarse for a node that needs little; /proc/PID/schedstat
    has ns, of the first thread only. The last known value where the process has gone, or the kernel has no
    such clock.
    """
    try:
        return time.clock_gettime(~process.pid << 3 | _CPU_CLOCK)
    except OSError:
        return process.cpu


def read_own_process() -> Process:
    """Read this process. OSError where /proc cannot be read."""
    found = read_process(os.getpid())
    if found is None:
        raise OSError("/proc/%d/stat cannot be read" % os.getpid())
    return found


def read_process_table() -> "dict[int, Process]":
    """Read every visible process that is not a zombie, by pid."""
    found = (read_process(int(name)) for name in os.listdir("/proc") if name.isdigit())
    return {each.pid: each for each in found if each is not None and each.state not in "ZX"}


def is_process_alive(pid: int, ticks: int) -> bool:
    """Whether the process that was seen as (pid, ticks) still runs."""
    found = read_process(pid) if pid > 0 else None
    return found is not None and found.ticks == ticks and found.state not in "ZX"


def group_children(table: "dict[int, Process]") -> "dict[int, list[int]]":
    """Group the pids of ``table`` by the pid of their parent."""
    found: "dict[int, list[int]]" = {}
    for each in table.values():
        found.setdefault(each.ppid, []).append(each.pid)
    return found


def find_descendants(pids: "set[int]", table: "dict[int, Process]") -> "set[int]":
    """Find ``pids`` and everything below them in ``table``."""
    below, todo = group_children(table), [pid for pid in pids if pid in table]
    found: "set[int]" = set()
    while todo:
        pid = todo.pop()
        if pid not in found:
            found.add(pid)
            todo += below.get(pid, ())
    return found


def has_environ_entry(pid: int, entry: bytes) -> bool:
    """Whether the process was started with ``NAME=value`` in its environment."""
    return b"\0" + entry + b"\0" in b"\0" + read_file("/proc/%d/environ" % pid) + b"\0"


def is_own_process(pid: int) -> bool:
    """Whether this user started the process: its real uid is ours.

    The owner of /proc/PID is no evidence: it is root for a process that forbids to be dumped.
    """
    for line in read_file("/proc/%d/status" % pid).splitlines():
        if line.startswith(b"Uid:"):
            return int(line.split()[1]) == os.geteuid()
    return False


def read_cmdline(pid: int) -> "list[str]":
    """Read the argument vector, decoded with replacement."""
    return [
        part.decode("utf-8", "replace")
        for part in read_file("/proc/%d/cmdline" % pid).rstrip(b"\0").split(b"\0")
    ]


def list_socket_inodes(pid: int) -> "set[int]":
    """List the inodes of the sockets that a process holds."""
    folder = "/proc/%d/fd/" % pid
    found = set()
    try:
        for name in os.listdir(folder):
            target = os.readlink(folder + name)
            if target.startswith("socket:["):
                found.add(int(target[8:-1]))
    except OSError:
        pass
    return found


def read_uptime_s() -> float:
    """Read the seconds since boot on the clock of start ticks (lxcfs shifts /proc/uptime, so that file is not
    read).
    """
    return time.clock_gettime(_CLOCK_BOOTTIME)


def age_s_from_ticks(ticks: int) -> float:
    """Convert the start ticks of a process to its age in seconds."""
    return max(0.0, read_uptime_s() - ticks / TICKS_PER_S)
