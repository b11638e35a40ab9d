"""What runs here, without measuring: operations status, wait and mark."""

import os
import time

from . import life, proc, record, state
from .errors import RefusalError

_POLL_S = 0.1
# A command that cannot even start ends within this time; before, running says nothing.
_SETTLE_S = 0.3


def current(host: str, task: str, table=None):
    """(trace, alive) of the living instance, else of the last one; (None, False) where the task never ran here."""
    found = [(each, life.is_alive(each, table)) for each in life.traces(host, task)]
    found = [pair for pair in found if pair[0].instance]
    return max(found, key=lambda pair: pair[1]) if found else (None, False)


def seen_generation(host: str, task: str) -> int:
    """The highest generation this host was ever given for the task."""
    folders = state.task_dirs(host, task)
    return max(
        [record.read(os.path.join(folder, "generation")).get("generation", 0) for folder in folders] or [0]
    )


def entries(host: str, task, table=None) -> dict:
    """Task -> entry of every task of this host, or of one."""
    found = {}
    for name in state.task_names(host) if task is None else [state.checked_name(task)]:
        trace, alive = current(host, name, table)
        document = life.entry(trace, alive) if trace is not None else {}
        if document:
            found[name] = document
    return found


def status(request: dict) -> dict:
    """Operation ``status``: one task, or all where ``task`` is null."""
    return {
        "v": 1,
        "op": "status",
        "host": request["host"],
        "boot_id": proc.boot_id(),
        "tasks": entries(request["host"], request.get("task")),
    }


def wait(request: dict) -> dict:
    """Operation ``wait``: the entry once the instance is ready, running without a ready check, ended or gone; else at the timeout."""
    deadline = time.monotonic() + float(request["timeout_s"])
    while True:
        trace, alive = current(request["host"], request["task"])
        document = life.entry(trace, alive) if trace is not None else {}
        if not document or document["instance"] != request["instance"]:
            return _gone(request["instance"])
        if not alive or _settled(trace, document) or time.monotonic() >= deadline:
            return document
        time.sleep(_POLL_S)


def _settled(trace, document: dict) -> bool:
    if document["state"] == "ready":
        return True
    # Between the end of the command and its record only the supervisor is seen, which is no sign that the command runs.
    runs = document["state"] == "running" and document["pid"] == trace.status.get("pid")
    return runs and not trace.instance.get("ready_check") and document["age_s"] >= _SETTLE_S


def _gone(instance: str) -> dict:
    return {
        "state": "failed", "pid": 0, "age_s": 0.0, "instance": instance, "spec_hash": "", "generation": 0,
        "managed": True, "restarts": 0, "exit_code": None, "detail": "not on this host",
    }  # fmt: skip


def mark(request: dict) -> dict:
    """Operation ``mark``: a ready check that ran elsewhere succeeded."""
    trace, alive = current(request["host"], request["task"])
    if not alive or trace.instance.get("instance") != request["instance"]:
        raise RefusalError(
            "not-running", "instance %s of %s does not run here" % (request["instance"], request["task"])
        )
    if request.get("ready"):
        document = {"instance": request["instance"], "restarts": trace.status.get("restarts", 0)}
        record.write(os.path.join(trace.folder, "mark"), document)
    return life.entry(trace, alive)
