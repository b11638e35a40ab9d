"""Where the one profiler of a host sits: a directory beside its tasks, with a lock that it holds as long as it lives."""

import os
import sys

from . import life, proc, record, ring, state
from .boot import check_private, private_dir
from .errors import RefusalError

_NAME, _LOCK, _RECORD = "profiler", "lock", "record"


def _places(host: str) -> list:
    return [levels + [os.path.join(levels[-1], _NAME)] for levels in state.host_places(host)]


def folders(host: str) -> list:
    """The seats that were ever taken, best first; none where somebody else could have made it."""
    found = []
    for levels in _places(host):
        try:
            for level in levels:
                check_private(level)
        except OSError:
            continue
        found.append(levels[-1])
    return found


def make(host: str) -> str:
    """The seat in the first place that takes a directory and its files of fixed size. Raises RefusalError."""
    reasons = []
    for levels in _places(host):
        try:
            for level in levels:
                private_dir(level)
            state.reserve(os.path.join(levels[-1], _LOCK), 0)
            state.reserve(os.path.join(levels[-1], _RECORD), record.SIZE)
            return levels[-1]
        except OSError as error:
            reasons.append("%s: %s" % (levels[0], error.strerror or error))
    raise RefusalError(
        "no-state-dir",
        "no place for the profiler: " + "; ".join(reasons),
        "free some disk space or set EDGECTL_STATE_DIR",
    )


def identity(fd: int) -> dict:
    """What tells this process, its ring in ``fd``, from every other."""
    me = proc.process(os.getpid())
    return {"pid": me.pid, "ticks": me.ticks, "boot_id": proc.boot_id(), "ring": fd}


def take(folder: str, known: dict) -> None:
    """Note who sits here; its ring is described already."""
    record.write(os.path.join(folder, _RECORD), known)


def leave(folder: str, why: str) -> None:
    """Note why nobody sits here any more; empty: it was asked to go."""
    try:
        record.write(os.path.join(folder, _RECORD), {"ended": why[:500]})
    except (OSError, ValueError):
        pass


def last_words(host: str) -> str:
    """Why the last profiler of the host is gone; empty where it was asked to go, or there was none."""
    for folder in folders(host):
        known = record.read(os.path.join(folder, _RECORD))
        if known:
            return known.get(
                "ended",
                "it was killed" if known.get("boot_id") == proc.boot_id() else "the host was rebooted",
            )
    return ""


def is_mine(folder: str, lock: int) -> bool:
    """Whether the seat's lock is the file that we hold: it may have been removed, or made again."""
    try:
        wanted, held = os.stat(os.path.join(folder, _LOCK)), os.fstat(lock)
    except OSError:
        return False
    return (wanted.st_dev, wanted.st_ino) == (held.st_dev, held.st_ino)


def is_taken(folder: str) -> bool:
    """Whether a profiler lives there."""
    return life.lock_held(folder)


class Sitter:
    """A profiler that lives: process and ring."""

    __slots__ = ("_ring", "folder", "pid", "ticks")

    def __init__(self, folder: str, pid: int, ticks: int, ring_fd: int) -> None:
        self.folder, self.pid, self.ticks, self._ring = folder, pid, ticks, ring_fd

    def read(self) -> tuple:
        """(description, number of the newest sample, that sample); empty ones where it is gone or has not begun."""
        try:
            fd = os.open("/proc/%d/fd/%d" % (self.pid, self._ring), os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            return {}, 0, {}
        try:
            description = ring.description(fd)
            # The process may have ended meanwhile and its number be another's.
            if (description.get("pid"), description.get("ticks")) != (self.pid, self.ticks):
                return {}, 0, {}
            return (description, *ring.newest(fd))
        finally:
            os.close(fd)


def sitter(host: str):
    """The profiler of the host that lives and has said who it is, else None."""
    for folder in folders(host):
        known = record.read(os.path.join(folder, _RECORD))
        pid, ticks = known.get("pid", 0), known.get("ticks", -1)
        if known.get("boot_id") == proc.boot_id() and proc.is_alive(pid, ticks):
            return Sitter(folder, pid, ticks, known["ring"])
    return None


def holders(folder: str) -> list:
    """Whoever holds the seat's lock, whatever the record says: (pid, start ticks)."""
    table = proc.processes()
    return [(pid, table[pid].ticks) for pid in sorted(life.lock_holders(folder, table))]


def wishes(request: dict) -> dict:
    """What a request wants to be measured, whatever the order in which it says so, and by which agent."""
    return {
        "agent": os.path.basename(getattr(sys.modules[__name__].__loader__, "root", "")),
        "links": {str(link["robot"]): str(link["address"]) for link in request.get("links") or []},
        "detect": {
            str(wish["task"]): {name: str(text) for name, text in wish.items()}
            for wish in request.get("detect") or []
        },
    }
