# SPDX-License-Identifier: Apache-2.0
"""Pid file and lock of the one profiler of a host, in a directory beside the tasks.

The profiler holds the lock while it lives.
"""

import os
import sys

from ..link.boot import check_private_dir, make_private_dir
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import proc, system_files
from ..supervise import lockfile, records, state_dir, task_dirs
from . import sample_ring

_NAME, _LOCK, _RECORD = "profiler", "lock", "record"


def _list_places(host: str) -> "list[list[str]]":
    return [levels + [os.path.join(levels[-1], _NAME)] for levels in state_dir.list_host_dirs(host)]


def list_folders(host: str) -> "list[str]":
    """List the existing private directories of the profiler, best first."""
    found = []
    for levels in _list_places(host):
        try:
            for level in levels:
                check_private_dir(level)
        except OSError:
            continue
        found.append(levels[-1])
    return found


def make_folder(host: str) -> str:
    """Create the directory in the first base that accepts it and its files of fixed size.

    Raises RefusalError.
    """
    reasons = []
    for levels in _list_places(host):
        try:
            for level in levels:
                make_private_dir(level)
            task_dirs.reserve_file(os.path.join(levels[-1], _LOCK), 0)
            task_dirs.reserve_file(os.path.join(levels[-1], _RECORD), records.RECORD_BYTES)
            return levels[-1]
        except OSError as error:
            reasons.append("%s: %s" % (levels[0], error.strerror or error))
    raise RefusalError(
        "no-state-dir",
        "no place for the profiler: " + "; ".join(reasons),
        "free some disk space or set EDGECTL_STATE_DIR",
    )


def build_identity(fd: int) -> Document:
    """Build the identity of this process and its ring in ``fd``."""
    me = proc.read_own_process()
    return {"pid": me.pid, "ticks": me.ticks, "boot_id": system_files.read_boot_id(), "ring": fd}


def write_pidfile(folder: str, known: Document) -> None:
    """Record the profiler; its ring is described already."""
    records.write_record(os.path.join(folder, _RECORD), known)


def write_end(folder: str, why: str) -> None:
    """Record the reason of the end; empty: it ended on request."""
    try:
        records.write_record(os.path.join(folder, _RECORD), {"ended": why[:500]})
    except (OSError, ValueError):
        pass


def read_end_reason(host: str) -> str:
    """Read the reason of the last profiler's end; empty where it ended on request, or there was none."""
    for folder in list_folders(host):
        known = records.read_record(os.path.join(folder, _RECORD))
        if known:
            return str(
                known.get(
                    "ended",
                    "it was killed"
                    if known.get("boot_id") == system_files.read_boot_id()
                    else "the host was rebooted",
                )
            )
    return ""


def is_own_lock(folder: str, lock: int) -> bool:
    """Whether the lock file is the one that we hold: it may have been removed, or created again."""
    try:
        wanted, held = os.stat(os.path.join(folder, _LOCK)), os.fstat(lock)
    except OSError:
        return False
    return (wanted.st_dev, wanted.st_ino) == (held.st_dev, held.st_ino)


def is_locked(folder: str) -> bool:
    """Whether a profiler lives there."""
    return lockfile.is_lock_held(folder)


class ProfilerProcess:
    """A living profiler: process and ring."""

    __slots__ = ("_ring", "folder", "pid", "ticks")

    def __init__(self, folder: str, pid: int, ticks: int, ring_fd: int) -> None:
        self.folder, self.pid, self.ticks, self._ring = folder, pid, ticks, ring_fd

    def read(self) -> "tuple[Document, int, Document]":
        """Read (description, number of the newest sample, that sample).

        Empty ones where it is gone or has not begun.
        """
        try:
            fd = os.open("/proc/%d/fd/%d" % (self.pid, self._ring), os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return {}, 0, {}
        try:
            description = sample_ring.read_description(fd)
            # The process may have ended meanwhile and its pid been reused.
            if (description.get("pid"), description.get("ticks")) != (self.pid, self.ticks):
                return {}, 0, {}
            number, sample = sample_ring.read_newest(fd)
            return description, number, sample
        finally:
            os.close(fd)


def find_profiler(host: str) -> "ProfilerProcess | None":
    """Find the living profiler of the host that has recorded its identity."""
    for folder in list_folders(host):
        known = records.read_record(os.path.join(folder, _RECORD))
        pid, ticks = known.get("pid", 0), known.get("ticks", -1)
        if known.get("boot_id") == system_files.read_boot_id() and proc.is_process_alive(pid, ticks):
            return ProfilerProcess(folder, pid, ticks, known["ring"])
    return None


def find_holders(folder: str) -> "list[tuple[int, int]]":
    """Find the holders of the lock, whatever the pid file says: (pid, start ticks)."""
    table = proc.read_process_table()
    return [(pid, table[pid].ticks) for pid in sorted(lockfile.find_lock_holders(folder, table))]


def build_probe_spec(request: Document) -> Document:
    """Build the probe spec of a request in canonical order: links, peers, tasks to detect, and the hash of
    the agent.
    """
    return {
        "agent": getattr(sys.modules[__name__].__loader__, "sha", ""),
        "links": _list_addresses(request.get("links")),
        "peers": _list_addresses(request.get("peers")),
        "detect": {
            str(rule["task"]): {name: str(text) for name, text in rule.items()}
            for rule in request.get("detect") or []
        },
    }


def _list_addresses(links: "list[Document] | None") -> "dict[str, str]":
    return {str(link["robot"]): str(link["address"]) for link in links or []}
