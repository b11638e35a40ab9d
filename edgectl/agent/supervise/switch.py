# SPDX-License-Identifier: Apache-2.0
"""Operations ``activate`` and ``deactivate``: make an instance active or inactive, proven by its record.

Everything that takes long is done before ``go``. After it the request checks once more what may have changed,
records that a change is under way, runs the command, and records what it has proven (ADR 109).
"""

import os
import time

from ..link import heartbeat, protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import proc
from . import lease, liveness, records, role, shell, signals, state_dir, status, switch_lock
from .liveness import InstanceRecord
from .transitions import Transition, prepare_transition

TYPE_CHECKING = False

_HINT = "edgectl probe, then plan again"
# A supervisor that activates a restarted process has the lock meanwhile.
_LOCK_S = 5.0
_MAX_DETAIL = 300


def activate_task(request: Document) -> Document:
    """Make an inactive instance active.

    Raises:
        RefusalError: nothing was done.
    """
    return _serve_switch(request, protocol.ROLE_ACTIVE)


def deactivate_task(request: Document) -> Document:
    """Make an active instance inactive; the reply ``standby`` is the proof that nothing of it is active.

    Raises:
        RefusalError: nothing was done.
    """
    return _serve_switch(request, protocol.ROLE_STANDBY)


def _serve_switch(request: Document, wanted: str) -> Document:
    shell.install_deadline_handlers()
    record = _find_instance(request, wanted)
    stated = _read_role(record)
    request = dict(request, spec=_fill_spec(request))
    needs_command = _needs_command(record, stated, wanted)
    transition = prepare_transition(record, request["spec"], wanted) if needs_command else None
    try:
        _record_generation(record, request)
        hold = request["hold"]
        if transition is not None and hold.seconds > 0.0 and not hold.await_go():
            return _build_reply(protocol.NOT_ASKED, _read_role(record))
        return lease.perform_before_claims(
            request, lambda again: _switch_exclusively(again, record, wanted, transition)
        )
    finally:
        if transition is not None:
            transition.end()


def _fill_spec(request: Document) -> Document:
    spec: Document = request["spec"]
    if not spec.get("ros") and not (spec.get("activation") or {}).get("lifecycle"):
        return spec
    from ..ros.local import fill_request
    from ..ros.question import start_helpers

    spec = fill_request(spec)
    start_helpers(spec, request["host"])
    return spec


def _find_instance(request: Document, wanted: str) -> InstanceRecord:
    """Find the living instance that the request names, in a state in which its role can change."""
    host, task = state_dir.check_name(request["host"]), state_dir.check_name(request["task"])
    status.check_generation(host, task, int(request["generation"]))
    record, alive = status.find_current(host, task)
    if record is None or not alive:
        raise RefusalError(protocol.NOT_RUNNING, "%s is not running here" % task, _HINT)
    instance = record.instance.get("instance")
    if instance != request["instance"]:
        message = "instance %s of %s runs here, not %s" % (instance, task, request["instance"])
        raise RefusalError("other-instance", message, _HINT)
    stated = _read_role(record)
    if not stated or not request["spec"].get("activation"):
        raise RefusalError("no-role", "%s was started without standby" % task, "edgectl restart " + task)
    if wanted == protocol.ROLE_ACTIVE:
        _check_activatable(record, stated, task)
    return record


def _check_activatable(record: InstanceRecord, stated: Document, task: str) -> None:
    if not liveness.find_supervisor(record):
        message = "%s has lost its supervisor, which would fence it" % task
        raise RefusalError("orphaned", message, "apply again: it gets a new one first")
    proven = role.is_proven_active(stated, *_get_process(record))
    if not proven and not (record.status.get("prepared") and _is_main_alive(record)):
        why = record.status.get("detail") or "its state is %s" % record.status.get("state", protocol.STARTING)
        raise RefusalError("not-prepared", "%s cannot be activated yet: %s" % (task, why), "apply again")


def _read_role(record: InstanceRecord) -> Document:
    return role.read_role(record.folder, str(record.instance.get("instance")))


def _get_process(record: InstanceRecord) -> "tuple[int, int]":
    return int(record.status.get("pid", 0)), int(record.status.get("ticks", -1))


def _is_main_alive(record: InstanceRecord) -> bool:
    return proc.is_process_alive(*_get_process(record))


def _needs_command(record: InstanceRecord, stated: Document, wanted: str) -> bool:
    """Whether the process has to be told, or the record alone changes.

    Raises:
        RefusalError: a process that was active has ended, and its supervisor has not seen to it yet.
    """
    if wanted == protocol.ROLE_ACTIVE:
        return not role.is_proven_active(stated, *_get_process(record))
    if stated["role"] == protocol.ROLE_STANDBY:
        return False
    if _is_main_alive(record):
        return role.is_begun(stated, *_get_process(record))
    if record.status.get("pid") or not liveness.find_supervisor(record):
        task = record.instance.get("task")
        raise RefusalError("restarting", "the process of %s has just ended" % task, "apply again")
    # Between the end of a process, whose leftovers the supervisor has ended, and the start of the next one.
    return False


def _record_generation(record: InstanceRecord, request: Document) -> None:
    """Refuse older managers from now on; before ``go``, because the disk takes its time."""
    generation = int(request["generation"])
    if status.read_generation(request["host"], request["task"]) < generation:
        path = os.path.join(record.folder, "generation")
        records.write_record(path, {"generation": generation}, durable=True)


def _switch_exclusively(
    request: Document, before: InstanceRecord, wanted: str, transition: "Transition | None"
) -> Document:
    """Change the role while nobody else does, if everything still is as it was when it was prepared."""
    lock = transition.lock if transition is not None else switch_lock.open_switch_lock(before.folder)
    try:
        if not switch_lock.take_switch_lock(lock, _LOCK_S):
            raise RefusalError("busy", "another activation is under way on this host", "apply again")
        record = _find_instance(request, wanted)
        stated = _read_role(record)
        if _get_process(record) != _get_process(before):
            raise RefusalError("restarting", "%s was restarted meanwhile" % request["task"], "apply again")
        if not _needs_command(record, stated, wanted):
            return _record_only(record, request, stated, wanted)
        if transition is None:
            raise RefusalError("busy", "the role of %s changed meanwhile" % request["task"], "apply again")
        if wanted == protocol.ROLE_ACTIVE:
            return _activate(record, request, stated, transition)
        return _deactivate(record, request, stated, transition)
    finally:
        if transition is None:
            os.close(lock)


def _record_only(record: InstanceRecord, request: Document, stated: Document, wanted: str) -> Document:
    """The process is as asked already: record it, and who has asked."""
    written = dict(stated, role=wanted, switching=False, generation=int(request["generation"]))
    if wanted == protocol.ROLE_STANDBY:
        written = _make_inactive(written)
    if written != stated:
        role.write_role(record.folder, written)
        _notify_supervisor(record)
    return _build_reply(wanted, written)


def _begin(record: InstanceRecord, request: Document, stated: Document) -> Document:
    """Record that the process may be active from now on, and that this is being changed."""
    pid, ticks = _get_process(record)
    begun = dict(stated, role=protocol.ROLE_ACTIVE, switching=True, pid=pid, ticks=ticks, done=False)
    begun["generation"] = int(request["generation"])
    role.write_role(record.folder, begun)
    return begun


def _make_inactive(stated: Document) -> Document:
    return dict(stated, role=protocol.ROLE_STANDBY, switching=False, pid=0, ticks=-1, done=False)


def _finish(record: InstanceRecord, written: Document) -> None:
    role.write_role(record.folder, written)
    _notify_supervisor(record)


def _notify_supervisor(record: InstanceRecord) -> None:
    """Let the supervisor look at the record now: it wakes up from any signal that it handles."""
    above = liveness.find_supervisor(record)
    if above:
        signals.send_signal(above, record.instance["supervisor_ticks"], signals.parse_signal("CHLD"))


def _activate(
    record: InstanceRecord, request: Document, stated: Document, transition: Transition
) -> Document:
    # Before the role: from then on the supervisor fences the instance by the age of this.
    heartbeat.record_heartbeat(request["host"])
    records.write_record(os.path.join(record.folder, "mark"), {})
    begun = _begin(record, request, stated)
    fault, seconds = _run(record, transition)
    if not fault:
        written = dict(begun, switching=False, done=True)
        _finish(record, written)
        return _build_reply(protocol.ROLE_ACTIVE, written, seconds)
    # Whatever it has done is undone, so that another instance may be active.
    undone = _run_other(record, request, transition, protocol.ROLE_STANDBY)
    written = begun if undone else _make_inactive(begun)
    _finish(record, written)
    detail = "activate: " + fault + ("; deactivate: " + undone if undone else "")
    return _build_reply(protocol.ACTIVATE_FAILED, written, seconds, detail)


def _deactivate(
    record: InstanceRecord, request: Document, stated: Document, transition: Transition
) -> Document:
    begun = _begin(record, request, stated)
    fault, seconds = _run(record, transition)
    if not fault:
        left = [begun["pid"], begun["ticks"], begun["generation"]]
        written = dict(_make_inactive(begun), left=left)
        _finish(record, written)
        return _build_reply(protocol.ROLE_STANDBY, written, seconds)
    undone = _run_other(record, request, transition, protocol.ROLE_ACTIVE)
    written = begun if undone else dict(begun, switching=False, done=True)
    _finish(record, written)
    detail = "deactivate: " + fault + ("; activate: " + undone if undone else "")
    reply = _build_reply(protocol.DEACTIVATE_FAILED, written, seconds, detail)
    return dict(reply, active_again=not undone)


def _run(record: InstanceRecord, transition: Transition) -> "tuple[str, float]":
    """Run what was prepared: why it failed, empty where it did not, and its seconds."""
    began = time.monotonic()
    fault = transition.run()
    seconds = time.monotonic() - began
    if not fault and not _is_main_alive(record):
        fault = "its process has ended"
    return fault, seconds


def _run_other(record: InstanceRecord, request: Document, failed: Transition, wanted: str) -> str:
    """Run the opposite of a transition that failed; why that failed, too, empty where it did not."""
    failed.end_command()
    try:
        other = prepare_transition(record, request["spec"], wanted, failed.lock)
    except RefusalError as error:
        return error.message
    try:
        return _run(record, other)[0]
    finally:
        other.end_command()


def _build_reply(state: str, stated: Document, seconds: float = 0.0, detail: str = "") -> Document:
    return {
        "state": state,
        "instance": stated.get("instance", ""),
        "role": stated.get("role", ""),
        "switching": bool(stated.get("switching")),
        "seconds": round(seconds, 6),
        "detail": detail[:_MAX_DETAIL],
    }
