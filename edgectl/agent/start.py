"""Operation ``start``: at most one living instance of a task on this host, whoever asks and however often."""

import fcntl
import os
import time

from . import lease, life, logind, proc, record, scope, state, status
from .errors import RefusalError

# Others look at a lock for some microseconds (life.lock_held); whoever holds it longer is a supervisor.
_LOOKS = 10
_LOOK_S = 0.03


def check_generation(host: str, task: str, generation: int) -> None:
    """Refuse a manager that knows less than this host. Raises RefusalError."""
    seen = status.seen_generation(host, task)
    if generation < seen:
        message = "generation %d of %s is older than %d, which this host has seen" % (generation, task, seen)
        raise RefusalError(
            "stale-generation",
            message,
            "another manager changed this task: run edgectl probe, then plan again",
        )


def take_lock(folder: str) -> int:
    """The task's lock, or -1 where its holder lives."""
    fd = record.open_private(os.path.join(folder, "lock"), os.O_RDWR | os.O_CREAT)
    for _ in range(_LOOKS):
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            time.sleep(_LOOK_S)
        else:
            return fd
    os.close(fd)
    return -1


def start(request: dict) -> dict:
    """Start the command under a supervisor of its own; where the task lives already, say which instance it is."""
    host, task, spec = (
        state.checked_name(request["host"]),
        state.checked_name(request["task"]),
        request["spec"],
    )
    way = scope.chosen(spec.get("runtime") or "auto", host, task, spec.get("limits"))
    logind.check_survival()
    check_generation(host, task, int(request["generation"]))
    trace, alive = status.current(host, task)
    if alive or _done_before(trace, request["instance"]):
        return _already(trace)
    folder = state.make_task_dir(host, task)
    lock = take_lock(folder)
    if lock < 0:
        return _already(_settled(folder))
    try:
        check_generation(host, task, int(request["generation"]))
        return _launched(folder, lock, request, way)
    finally:
        os.close(lock)


def _done_before(trace, instance: str) -> bool:
    """A start that is repeated is the same start: a job that has completed is not run again."""
    return (
        trace is not None
        and trace.instance.get("instance") == instance
        and trace.status.get("state") == "completed"
    )


def _settled(folder: str):
    """The trace of whoever was faster, once it has written who it is."""
    for _ in range(_LOOKS):
        trace = life.trace(folder)
        if trace.status.get("pid"):
            break
        time.sleep(_LOOK_S)
    return trace


def _already(trace) -> dict:
    known = trace.instance
    document = life.entry(trace, alive=trace.held)
    return {
        "state": "already-running",
        "pid": document.get("pid", 0),
        "instance": known.get("instance", ""),
        "generation": known.get("generation", 0),
        "detail": document.get("detail") or "state is %s" % document.get("state", "starting"),
    }


def _launched(folder: str, lock: int, request: dict, way) -> dict:
    from .launch import launch

    generation = {"generation": int(request["generation"])}
    record.write(os.path.join(folder, "generation"), generation, durable=True)
    record.write(os.path.join(folder, "mark"), {})
    # The first request to a host finds no place for its stamp.
    lease.renew(request["host"])
    report = launch(folder, lock, _identity(request, request["spec"]), request["spec"], way)
    if "error" in report:
        raise RefusalError("start-failed", report["error"], "look at the task's command, workdir and env")
    limits = "" if report["limits"] in ("", "enforced") else "limits: " + report["limits"]
    return {
        "state": "started",
        "pid": report["pid"],
        "instance": request["instance"],
        "detail": limits,
        **generation,
    }


def _identity(request: dict, spec: dict) -> dict:
    """What is kept about the instance: never its command, prelude or environment, which may hold secrets."""
    return {
        "instance": str(request["instance"]),
        "host": request["host"],
        "task": request["task"],
        "generation": int(request["generation"]),
        "spec_hash": str(spec.get("spec_hash", "")),
        "kind": spec.get("kind", "service"),
        "stop": spec.get("stop") or {},
        "ready_check": bool(spec.get("ready")),
        "fields": _fields(spec.get("fields")),
        "boot_id": proc.boot_id(),
        "machine_id": proc.read("/etc/machine-id").decode("ascii", "replace").strip(),
    }


def _fields(stated) -> dict:
    """The digests of the spec's fields, within what a record of 2 KiB can take."""
    return {str(name)[:24]: str(digest)[:12] for name, digest in sorted((stated or {}).items())[:20]}
