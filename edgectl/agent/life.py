"""Whether a task lives, and which processes are its own. The kernel says so, not a file.

A task lives while its lock is held (supervisor and task inherit it) or any process carries its cookie in its environment:
launchers that close inherited descriptors are the main workload, so both are asked.
"""

import fcntl
import os
import time

from . import proc, record, state

_LAST_LOOKS, _LAST_LOOK_S = 25, 0.02
_LAST_LINES, _LAST_LINE_LENGTH = 5, 200
FINAL = ("completed", "failed", "crashloop", "stopped")


class Trace:
    """What one task directory says: ``instance`` who was started, ``status`` how far it is, ``held`` whether its lock is taken."""

    __slots__ = ("folder", "held", "instance", "status")

    def __init__(self, folder: str, instance: dict, status: dict, held: bool) -> None:
        self.folder, self.instance, self.status, self.held = folder, instance, status, held


def cookie(folder: str) -> str:
    """The environment entry that marks every process of the task that lives in ``folder``."""
    return "EDGECTL_TASK_DIR=" + folder


def is_marked(pid: int) -> bool:
    """Whether the process belongs to some task of edgectl, be it another host's on this machine."""
    return b"\0EDGECTL_TASK_DIR=" in b"\0" + proc.read("/proc/%d/environ" % pid)


def lock_held(folder: str) -> bool:
    """Whether somebody holds the task's lock. Looks with a shared lock, so that two who look do not see each other."""
    try:
        fd = record.open_private(os.path.join(folder, "lock"), os.O_RDONLY)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(fd)
    return False


def trace(folder: str) -> Trace:
    """Read a task directory."""
    held = lock_held(folder)
    instance = record.read(os.path.join(folder, "instance"))
    status = record.read(os.path.join(folder, "status"))
    if status.get("instance") != instance.get("instance"):
        status = {}
    elif held and status.get("state") in FINAL and not status.get("left"):
        held = _held_for_long(folder)
    return Trace(folder, instance, status, held)


def _held_for_long(folder: str) -> bool:
    """The supervisor notes the end and is gone some milliseconds later: between the two it is no sign of life."""
    for _ in range(_LAST_LOOKS):
        if not lock_held(folder):
            return False
        time.sleep(_LAST_LOOK_S)
    return True


def traces(host: str, task: str) -> list:
    """One Trace for each place in which the task was ever started."""
    return [trace(folder) for folder in state.task_dirs(host, task)]


def supervisor(found: Trace) -> int:
    """The pid of the supervisor where that very process still runs, else 0."""
    pid, ticks = found.instance.get("supervisor", 0), found.instance.get("supervisor_ticks", -1)
    return pid if same_boot(found) and proc.is_alive(pid, ticks) else 0


def same_boot(found: Trace) -> bool:
    """Whether the task was started since the host was booted."""
    return found.instance.get("boot_id") == proc.boot_id()


def members(found: Trace, table: dict) -> set:
    """Pids of the task's processes, without the supervisor: everything below it, else whatever carries cookie, lock or session."""
    above = supervisor(found)
    if above:
        return proc.descendants({above}, table) - {above}
    return orphans(found, table)


def orphans(found: Trace, table: dict) -> set:
    """The task's processes that are found without its supervisor."""
    entry = cookie(found.folder).encode()
    seeds = {pid for pid in table if proc.environ_has(pid, entry)}
    main, ticks = found.status.get("pid", 0), found.status.get("ticks", -1)
    if same_boot(found) and main in table and table[main].ticks == ticks:
        seeds.add(main)
    if found.held:
        seeds |= lock_holders(found.folder, table)
    # A session number stays taken while any member lives: one known member proves that it is still the task's.
    if any(table[pid].sid == main for pid in seeds):
        seeds |= {pid for pid, each in table.items() if each.sid == main}
    return proc.descendants(seeds, table) - {os.getpid()}


def lock_holders(folder: str, table: dict) -> set:
    """Pids that hold the task's lock: what is left where even the environment was emptied."""
    path = os.path.join(folder, "lock")
    try:
        wanted = os.stat(path)
    except OSError:
        return set()
    return {pid for pid in table if pid != os.getpid() and _holds(pid, wanted)}


def _holds(pid: int, wanted) -> bool:
    """Open is not enough: another agent that only looks at the lock has it open for a moment, too."""
    folder = "/proc/%d/fd/" % pid
    try:
        for name in os.listdir(folder):
            info = os.stat(folder + name)
            same = (info.st_dev, info.st_ino) == (wanted.st_dev, wanted.st_ino)
            if same and b"WRITE" in proc.read("/proc/%d/fdinfo/%s" % (pid, name)):
                return True
    except OSError:
        pass
    return False


def is_alive(found: Trace, table=None) -> bool:
    """Lock held, or a cookie found; the processes are only searched where the record does not say that all ended."""
    if found.held:
        return True
    if (
        not found.instance
        or not same_boot(found)
        or found.status.get("state") in FINAL
        and not found.status.get("left")
    ):
        return False
    return bool(orphans(found, proc.processes() if table is None else table))


def entry(found: Trace, alive: bool) -> dict:
    """The task's part of a reply, without rates; empty for a task that was stopped on purpose or never ran."""
    instance, status = found.instance, found.status
    if not instance or (not alive and status.get("state") == "stopped"):
        return {}
    document = {
        "state": status.get("state", "starting"),
        "pid": 0,
        "age_s": 0.0,
        "instance": instance.get("instance", ""),
        "spec_hash": instance.get("spec_hash", ""),
        "fields": instance.get("fields") or {},
        "generation": instance.get("generation", 0),
        "managed": True,
        "restarts": status.get("restarts", 0),
        "exit_code": status.get("exit_code"),
        "detail": status.get("detail", ""),
        "limits": status.get("limits", ""),
        "last_exit": status.get("last_exit"),
        "given_up": bool(status.get("given_up")),
    }
    document.update(_living(found) if alive else _dead(found))
    if document["state"] in ("failed", "crashloop"):
        document["log_tail"] = _log_tail(found.folder)
    return document


def _log_tail(folder: str) -> list:
    """The last words of a task that failed."""
    from .logs import tail

    lines = tail(folder, _LAST_LINES, _LAST_LINES * 20000).decode("utf-8", "replace").splitlines()
    return [line[:_LAST_LINE_LENGTH] for line in lines[-_LAST_LINES:]]


def _living(found: Trace) -> dict:
    status, above = found.status, supervisor(found)
    main, ticks = status.get("pid", 0), status.get("ticks", -1)
    if not proc.is_alive(main, ticks):
        main, ticks = above, found.instance.get("supervisor_ticks", -1)
    seen = {"pid": main, "age_s": round(proc.age(ticks), 2) if main else 0.0}
    if status.get("state") == "running" and _marked(found):
        seen["state"] = "ready"
    if status.get("state") in FINAL:
        seen.update(state="running", detail="processes of the ended task are left")
    if not above:
        seen["detail"] = "orphaned: the supervisor is gone, its processes are not"
    return seen


def _marked(found: Trace) -> bool:
    mark = record.read(os.path.join(found.folder, "mark"))
    return mark.get("instance") == found.instance.get("instance") and mark.get(
        "restarts"
    ) == found.status.get("restarts")


def _dead(found: Trace) -> dict:
    if found.status.get("state") in FINAL:
        return _ended(found)
    why = "unknown: the supervisor was lost" if same_boot(found) else "the host was rebooted"
    return {"state": "failed", "exit_code": None, "detail": why}


def _ended(found: Trace) -> dict:
    """How long ago it ended, in s, where that was in this boot. 0 where it seems to lie ahead: the manager takes no negative age."""
    if not same_boot(found) or "ended" not in found.status:
        return {}
    return {"ended_s": round(max(0.0, proc.uptime() - found.status["ended"]), 2)}
