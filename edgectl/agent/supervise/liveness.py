# SPDX-License-Identifier: Apache-2.0
"""Liveness of a task and its processes, decided by the kernel and not by a file.

A task lives while its lock is held (supervisor and task inherit it) or any process of this user has its
cookie in the environment: launchers that close inherited descriptors are the main workload, so both are
examined.
"""

import os
import time

from ..link import protocol
from ..link.fast_json import Document
from ..measure import proc, system_files
from . import lockfile, node_record, records, role, state_dir

_LAST_TRIES, _LAST_TRY_S = 25, 0.02
_LAST_LINES, _LAST_LINE_LENGTH = 5, 200


class InstanceRecord:
    """Content of a task directory: ``instance`` (identity), ``status`` (progress) and ``locked`` (whether its
    lock is held).
    """

    __slots__ = ("folder", "locked", "instance", "status")

    def __init__(self, folder: str, instance: Document, status: Document, locked: bool) -> None:
        self.folder, self.instance, self.status, self.locked = folder, instance, status, locked


def build_cookie(folder: str) -> str:
    """Build the environment entry that marks every process of the task in ``folder``."""
    return "EDGECTL_TASK_DIR=" + folder


def has_cookie(pid: int) -> bool:
    """Whether the process belongs to any task of edgectl, including another host's on this machine."""
    return b"\0EDGECTL_TASK_DIR=" in b"\0" + system_files.read_file("/proc/%d/environ" % pid)


def read_instance(folder: str) -> InstanceRecord:
    """Read a task directory."""
    locked = lockfile.is_lock_held(folder)
    instance = records.read_record(os.path.join(folder, "instance"))
    status = records.read_record(os.path.join(folder, "status"))
    if status.get("instance") != instance.get("instance"):
        status = {}
    elif locked and status.get("state") in protocol.FINAL_STATES and not status.get("left"):
        locked = _stays_locked(folder)
    return InstanceRecord(folder, instance, status, locked)


def _stays_locked(folder: str) -> bool:
    """Whether the lock stays held: the supervisor records the end some milliseconds before it exits, and is
    no sign of life in between.
    """
    for _ in range(_LAST_TRIES):
        if not lockfile.is_lock_held(folder):
            return False
        time.sleep(_LAST_TRY_S)
    return True


def read_instances(host: str, task: str) -> "list[InstanceRecord]":
    """Read one InstanceRecord for each directory in which the task was ever started."""
    return [read_instance(folder) for folder in state_dir.find_task_dirs(host, task)]


def find_supervisor(found: InstanceRecord) -> int:
    """Find the pid of the supervisor where that very process still runs, else 0."""
    pid, ticks = found.instance.get("supervisor", 0), found.instance.get("supervisor_ticks", -1)
    return pid if is_same_boot(found) and proc.is_process_alive(pid, ticks) else 0


def is_same_boot(found: InstanceRecord) -> bool:
    """Whether the task was started since the last boot of the host."""
    return found.instance.get("boot_id") == system_files.read_boot_id()


def find_processes(found: InstanceRecord, table: "dict[int, proc.Process]") -> "set[int]":
    """Find the task's processes without the supervisor: all below it, else every carrier of cookie, lock or
    session.
    """
    above = find_supervisor(found)
    if above and found.instance.get("image"):
        below = proc.find_descendants({above}, table) - {above}
        return below | _find_in_container(found.folder, table)
    if above and found.instance.get("adopted"):
        return (proc.find_descendants({above}, table) | find_orphans(found, table)) - {above}
    if above:
        return proc.find_descendants({above}, table) - {above}
    return find_orphans(found, table)


def find_orphans(found: InstanceRecord, table: "dict[int, proc.Process]") -> "set[int]":
    """Find the task's processes without the help of its supervisor.

    Any user can write the cookie into the environment of a process, so it counts only in one of this user. A
    process of the task that has become another user's is found by descent, by its session or by the lock.
    """
    entry = build_cookie(found.folder).encode()
    seeds = {pid for pid in table if proc.has_environ_entry(pid, entry) and proc.is_own_process(pid)}
    main, ticks = found.status.get("pid", 0), found.status.get("ticks", -1)
    if is_same_boot(found) and main in table and table[main].ticks == ticks:
        seeds.add(main)
    if found.locked:
        seeds |= lockfile.find_lock_holders(found.folder, table)
    seeds |= _find_in_container(found.folder, table)
    # A session id is not reused while any member lives: one known member proves that it is still the task's.
    if any(table[pid].sid == main for pid in seeds):
        seeds |= {pid for pid, each in table.items() if each.sid == main}
    return proc.find_descendants(seeds, table) - {os.getpid()}


def _find_in_container(folder: str, table: "dict[int, proc.Process]") -> "set[int]":
    if not os.path.exists(os.path.join(folder, "container")):
        return set()
    from ..containers.record import find_container_processes

    return find_container_processes(folder, table)


def _may_start(folder: str) -> bool:
    """Whether a swarm may start the container of the task at any time, whoever lives (ADR 171)."""
    from ..containers.record import may_start

    return may_start(folder)


def may_live(folder: str) -> bool:
    """Whether the record leaves it open that the task lives: cheap, for most have ended."""
    known = records.read_record(os.path.join(folder, "status"))
    open_end = known.get("state") not in protocol.FINAL_STATES or bool(known.get("left"))
    return open_end or (os.path.exists(os.path.join(folder, "container")) and _may_start(folder))


def is_alive(found: InstanceRecord, table: "dict[int, proc.Process] | None" = None) -> bool:
    """Whether the lock is held, or the supervisor or a cookie is found: a supervisor that took over a task
    has the lock only once the processes that it found have ended.

    Processes are searched only where the record does not state the end.
    """
    if found.locked or (found.instance.get("image") and _may_start(found.folder)):
        return True
    ended = found.status.get("state") in protocol.FINAL_STATES and not found.status.get("left")
    if ended or not found.instance or not is_same_boot(found):
        return False
    if find_supervisor(found):
        return True
    return bool(find_orphans(found, proc.read_process_table() if table is None else table))


def build_entry(found: InstanceRecord, alive: bool) -> Document:
    """Build the task's entry in a reply, without rates.

    Empty for a task that was stopped on purpose or never ran.
    """
    instance, status = found.instance, found.status
    if not instance or (not alive and status.get("state") == protocol.STOPPED):
        return {}
    stated = role.read_role(found.folder, str(instance.get("instance")))
    document = {
        "state": status.get("state", protocol.STARTING),
        "pid": 0,
        "age_s": 0.0,
        "instance": instance.get("instance", ""),
        "spec_hash": instance.get("spec_hash", ""),
        "fields": instance.get("fields") or {},
        "file": instance.get("file", ""),
        "needed": instance.get("needed", ""),
        "generation": max(instance.get("generation", 0), stated.get("generation", 0)),
        "role": stated.get("role", ""),
        "switching": bool(stated.get("switching")),
        "deactivated": role.find_deactivated(stated, status.get("pid", 0), status.get("ticks", -1)),
        "managed": True,
        "restarts": status.get("restarts", 0),
        "exit_code": status.get("exit_code"),
        "detail": status.get("detail", ""),
        "limits": status.get("limits", ""),
        "last_exit": status.get("last_exit"),
        "given_up": bool(status.get("given_up")),
        "nodes": node_record.list_registered(found.folder),
    }
    document.update(_build_living_fields(found, stated) if alive else _build_dead_fields(found))
    if alive and instance.get("image"):
        from ..containers.record import describe_container

        document.update(describe_container(found.folder))
    if document["state"] in protocol.FAILED_STATES:
        document["log_tail"] = _read_last_lines(found.folder)
    return document


def _read_last_lines(folder: str) -> "list[str]":
    """Read the end of the log of a failed task."""
    from .logfile import read_log_tail

    lines = read_log_tail(folder, _LAST_LINES, _LAST_LINES * 20000).decode("utf-8", "replace").splitlines()
    return [line[:_LAST_LINE_LENGTH] for line in lines[-_LAST_LINES:]]


def _build_living_fields(found: InstanceRecord, stated: Document) -> Document:
    status, above = found.status, find_supervisor(found)
    main, ticks = status.get("pid", 0), status.get("ticks", -1)
    if not proc.is_process_alive(main, ticks):
        main, ticks = above, found.instance.get("supervisor_ticks", -1)
    seen = {"pid": main, "age_s": round(proc.age_s_from_ticks(ticks), 2) if main else 0.0}
    if status.get("state") == protocol.RUNNING and _is_marked_ready(found):
        seen["state"] = protocol.READY
    if stated and status.get("state") in protocol.ALIVE_STATES:
        seen.update(_correct_state(found, stated))
    if status.get("state") in protocol.FINAL_STATES:
        seen.update(state=protocol.RUNNING, detail="processes of the ended task remain")
    if not above:
        seen.update(
            orphaned=True,
            adoptable=is_adoptable(found),
            detail="orphaned: the supervisor is gone, its processes still run",
        )
    return seen


def _correct_state(found: InstanceRecord, stated: Document) -> Document:
    """The state where the role was just changed, and the supervisor has not seen it yet.

    What was recorded of an active instance says nothing of a standby, and the other way round.
    """
    was_active, is_active = bool(found.status.get("active")), stated["role"] == protocol.ROLE_ACTIVE
    if was_active == is_active or found.status.get("state") == protocol.STARTING:
        return {}
    return {"state": protocol.STARTING if is_active else protocol.READY, "detail": ""}


def is_adoptable(record: InstanceRecord) -> bool:
    """Whether a new supervisor can take the task over: not in a scope, whose limits it would leave."""
    pids = find_orphans(record, proc.read_process_table())
    return not any(b"/edgectl-" in system_files.read_file("/proc/%d/cgroup" % pid) for pid in pids)


def _is_marked_ready(found: InstanceRecord) -> bool:
    mark = records.read_record(os.path.join(found.folder, "mark"))
    return mark.get("instance") == found.instance.get("instance") and mark.get(
        "restarts"
    ) == found.status.get("restarts")


def _build_dead_fields(found: InstanceRecord) -> Document:
    if found.status.get("state") in protocol.FINAL_STATES:
        return _build_ended_fields(found)
    why = "unknown: the supervisor was lost" if is_same_boot(found) else "the host was rebooted"
    return {"state": protocol.FAILED, "exit_code": None, "detail": why}


def _build_ended_fields(found: InstanceRecord) -> Document:
    """Build ``ended_s``, the seconds since the end, where that was in this boot.

    At least 0: the manager rejects a negative age.
    """
    if not is_same_boot(found) or "ended" not in found.status:
        return {}
    return {"ended_s": round(max(0.0, proc.read_uptime_s() - found.status["ended"]), 2)}
