# SPDX-License-Identifier: Apache-2.0
"""Operations ``status``, ``wait`` and ``mark``: tasks of this host without measuring."""

import os
import time

from ..link import protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import proc, system_files
from . import liveness, records, state_dir
from .liveness import InstanceRecord

# From one look at what is waited for to the next: a share of the time since, within bounds.
_POLL_SHARE, _MIN_POLL_S, _MAX_POLL_S = 0.05, 0.02, 0.1
# Between them from one look to the next at whether the supervisor has written, which costs a tenth; as above.
_GLANCE_SHARE, _MIN_GLANCE_S = 0.01, 0.01
# A command that cannot start ends within this time; until then, running is no evidence.
_SETTLE_S = 0.3


def find_current(
    host: str, task: str, table: "dict[int, proc.Process] | None" = None
) -> "tuple[InstanceRecord | None, bool]":
    """Find (record, alive) of the living instance, else of the last one.

    (None, False) where the task never ran here.
    """
    found = [(each, liveness.is_alive(each, table)) for each in liveness.read_instances(host, task)]
    return max([pair for pair in found if pair[0].instance], key=lambda pair: pair[1], default=(None, False))


def read_generation(host: str, task: str) -> int:
    """Read the highest generation that this host was given for the task."""
    folders = state_dir.find_task_dirs(host, task)
    return max(
        [
            int(records.read_record(os.path.join(folder, "generation")).get("generation", 0))
            for folder in folders
        ]
        or [0]
    )


def list_entries(
    host: str, task: "str | None", table: "dict[int, proc.Process] | None" = None
) -> "dict[str, Document]":
    """List task -> entry of every task of this host, or of one."""
    found = {}
    for name in state_dir.list_task_names(host) if task is None else [state_dir.check_name(task)]:
        record, alive = find_current(host, name, table)
        document = liveness.build_entry(record, alive) if record is not None else {}
        if document:
            found[name] = document
    return found


def report_status(request: Document) -> Document:
    """Operation ``status``: one task, or all where ``task`` is null."""
    return {
        "v": protocol.VERSION,
        "op": protocol.OP_STATUS,
        "host": request["host"],
        "boot_id": system_files.read_boot_id(),
        "tasks": list_entries(request["host"], request.get("task")),
    }


def wait_for_task(request: Document) -> Document:
    """Operation ``wait``: the entry once the instance is ready, ran for ``up_s`` without a ready check, ended
    or is gone.

    Else at the timeout, with ``settled`` false.
    """
    began = time.monotonic()
    deadline = began + float(request["timeout_s"])
    folder = ""
    while True:
        # Before the look: what is written meanwhile ends the pause after it.
        written = read_written_ns(folder)
        record, alive = find_current(request["host"], request["task"])
        document = liveness.build_entry(record, alive) if record is not None else {}
        if not document or document["instance"] != request["instance"]:
            return _build_gone_entry(request["instance"])
        settled = record is not None and _is_settled(record, document, float(request.get("up_s") or 0.0))
        if not alive or settled or time.monotonic() >= deadline:
            return dict(document, settled=settled)
        since, folder = time.monotonic() - began, record.folder if record is not None else ""
        pause_until_written(
            folder,
            written,
            min(_MAX_POLL_S, max(_MIN_POLL_S, _POLL_SHARE * since)),
            max(_MIN_GLANCE_S, _GLANCE_SHARE * since),
        )


def read_written_ns(folder: str) -> int:
    """Read when the status of a task was written last (ns of the file's clock); 0 where it has none."""
    try:
        return os.stat(folder + "/status").st_mtime_ns
    except OSError:
        return 0


def pause_until_written(folder: str, written: int, pause_s: float, glance_s: float) -> None:
    """Wait until the status is written, which it was last at ``written``; at most ``pause_s``."""
    until = time.monotonic() + pause_s
    while read_written_ns(folder) == written:
        left = until - time.monotonic()
        if left <= 0.0:
            return
        time.sleep(min(left, glance_s))


def _is_settled(record: InstanceRecord, document: Document, up_s: float) -> bool:
    if document["state"] == protocol.READY:
        return True
    # Between the end of the command and its record only the supervisor is seen, which is no evidence that the
    # command runs.
    runs = document["state"] == protocol.RUNNING and document["pid"] == record.status.get("pid")
    return runs and not record.instance.get("ready_check") and document["age_s"] >= max(up_s, _SETTLE_S)


def _build_gone_entry(instance: str) -> Document:
    return {
        "state": protocol.FAILED,
        "pid": 0,
        "age_s": 0.0,
        "instance": instance,
        "spec_hash": "",
        "generation": 0,
        "managed": True,
        "restarts": 0,
        "exit_code": None,
        "detail": "not on this host",
    }


def mark_task(request: Document) -> Document:
    """Operation ``mark``: record the success of a ready check that ran elsewhere, or that a successor starts
    elsewhere for ``leaving_s``: then an instance that is not alive is left alone, and no entry is replied.
    """
    record, alive = find_current(request["host"], request["task"])
    leaving_s = request.get("leaving_s")
    if leaving_s is not None:
        if record is None or not alive or record.instance.get("instance") != request["instance"]:
            return {}
        # Imported on demand: every request loads this module, and few of them mark.
        from . import successor

        successor.write_leaving(record.folder, request["instance"], float(leaving_s))
        return liveness.build_entry(record, alive)
    if record is None or not alive or record.instance.get("instance") != request["instance"]:
        raise RefusalError(
            protocol.NOT_RUNNING,
            "instance %s of %s is not running here" % (request["instance"], request["task"]),
        )
    if request.get("ready"):
        document = {"instance": request["instance"], "restarts": record.status.get("restarts", 0)}
        records.write_record(os.path.join(record.folder, "mark"), document)
    return liveness.build_entry(record, alive)


def check_generation(host: str, task: str, generation: int) -> None:
    """Decline a generation lower than the highest seen. Raises RefusalError."""
    seen = read_generation(host, task)
    if generation < seen:
        message = "generation %d of %s is older than %d, the highest seen by this host" % (
            generation,
            task,
            seen,
        )
        raise RefusalError(
            "stale-generation",
            message,
            "another manager changed this task: run edgectl probe, then plan again",
        )
