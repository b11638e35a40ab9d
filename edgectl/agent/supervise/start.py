# SPDX-License-Identifier: Apache-2.0
"""Operation ``start``: at most one living instance of a task on this host, however many managers ask, however
often.
"""

import os
import time

from ..link import heartbeat, protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import system_files
from . import liveness, lockfile, logind, records, role, scope, state_dir, status, task_dirs
from .liveness import InstanceRecord

# A start on a busy host may take seconds.
_TRIES, _TRY_S = 100, 0.05
_MAX_FILE = 200
_MAX_MANAGER_LENGTH = 100
_MAX_NEEDED = 120


def start_task(request: Document) -> Document:
    """Start the command under a supervisor of its own.

    Where the task is alive already, report its instance.
    """
    host, task, spec = (
        state_dir.check_name(request["host"]),
        state_dir.check_name(request["task"]),
        request["spec"],
    )
    task_scope = _choose_scope(spec, host, task)
    logind.check_survives_logout()
    status.check_generation(host, task, int(request["generation"]))
    record, alive = status.find_current(host, task)
    if record is not None and (alive or _has_completed(record, request["instance"])):
        return _build_running_reply(record)
    folder = task_dirs.make_task_dir(host, task)
    lock = lockfile.take_lock(folder)
    if lock < 0:
        return _build_running_reply(_wait_for_record(folder))
    try:
        status.check_generation(host, task, int(request["generation"]))
        if not request.get("keep_state"):
            task_dirs.drop_spools(host, task)
        return _launch_task(folder, lock, request, task_scope)
    finally:
        os.close(lock)


def _choose_scope(spec: Document, host: str, task: str) -> scope.Scope:
    """The scope of the supervisor. A container has a control group of its own, and its limits there."""
    if spec.get("image"):
        from ..containers.engine import choose_program

        choose_program(spec["image"].get("engine"))
        return scope.Scope([], {}, "")
    return scope.choose_scope(spec.get("runtime") or "auto", host, task, spec.get("limits"))


def _has_completed(record: InstanceRecord, instance: str) -> bool:
    """Whether this instance is a completed job: a repeated start request does not run it again."""
    return (
        bool(record.instance.get("instance") == instance) and record.status.get("state") == protocol.COMPLETED
    )


def _wait_for_record(folder: str) -> InstanceRecord:
    """Wait for the record of the concurrent start that took the lock, while it holds that."""
    record = liveness.read_instance(folder)
    for _ in range(_TRIES):
        if record.status.get("pid") or not record.locked:
            break
        time.sleep(_TRY_S)
        record = liveness.read_instance(folder)
    return record


def _build_running_reply(record: InstanceRecord) -> Document:
    known = record.instance
    document = liveness.build_entry(record, alive=record.locked)
    return {
        "state": protocol.ALREADY_RUNNING,
        "pid": document.get("pid", 0),
        "instance": known.get("instance", ""),
        "generation": known.get("generation", 0),
        "role": document.get("role", ""),
        "detail": document.get("detail") or "state is %s" % document.get("state", protocol.STARTING),
    }


def _launch_task(folder: str, lock: int, request: Document, task_scope: scope.Scope) -> Document:
    from .launch import launch_supervisor

    spec = request["spec"]
    if spec.get("ros"):
        from ..ros.local import fill_request
        from ..ros.question import start_helpers

        spec = fill_request(spec)
        start_helpers(spec, request["host"])
    generation = {"generation": int(request["generation"])}
    records.write_record(os.path.join(folder, "generation"), generation, durable=True)
    records.write_record(os.path.join(folder, "mark"), {})
    if spec.get("image"):
        for name in ("container", "container-removed"):
            task_dirs.reserve_file(os.path.join(folder, name), records.RECORD_BYTES)
    role.begin_role(
        folder, spec, str(request["instance"]), str(request.get("role")), generation["generation"]
    )
    # The first request to a host has no directory for its heartbeat yet.
    heartbeat.record_heartbeat(request["host"])
    report = launch_supervisor(folder, lock, _build_identity(request, spec), spec, task_scope)
    if "error" in report:
        raise RefusalError("start-failed", report["error"], "check the task's command, workdir and env")
    limits = "" if report["limits"] in ("", "enforced") else "limits: " + report["limits"]
    return {
        "state": protocol.STARTED,
        "pid": report["pid"],
        "instance": request["instance"],
        "role": str(role.read_role(folder, str(request["instance"])).get("role", "")),
        "detail": limits,
        **generation,
    }


def _build_identity(request: Document, spec: Document) -> Document:
    """Build the stored identity of the instance: never its command, prelude or environment, which may contain
    secrets.
    """
    return {
        "instance": str(request["instance"]),
        "fleet": state_dir.get_fleet(),
        "manager": str(request.get("manager", ""))[:_MAX_MANAGER_LENGTH],
        "host": request["host"],
        "task": request["task"],
        "generation": int(request["generation"]),
        "spec_hash": str(spec.get("spec_hash", "")),
        "image": str((spec.get("image") or {}).get("name", ""))[:_MAX_FILE],
        "kind": spec.get("kind", "service"),
        "stop": spec.get("stop") or {},
        "ready_check": bool(spec.get("ready")),
        "fields": _trim_fields(spec.get("fields")),
        "file": str(spec.get("file", ""))[:_MAX_FILE],
        "needed": str(spec.get("needed") or "")[:_MAX_NEEDED],
        "boot_id": system_files.read_boot_id(),
        "machine_id": system_files.read_machine_id(),
    }


def _trim_fields(stated: "Document | None") -> "dict[str, str]":
    """Trim the digests of the spec's fields to the size of a record (2 KiB)."""
    return {str(name)[:24]: str(digest)[:12] for name, digest in sorted((stated or {}).items())[:20]}
