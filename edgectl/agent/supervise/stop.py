# SPDX-License-Identifier: Apache-2.0
"""Operation ``stop``: end the whole process tree, gently and then by force, with the kernel's proof that
nothing is left.
"""

import os
import time

from ..link import protocol
from ..link.fast_json import Document
from ..measure import proc
from . import liveness, lockfile, nodes, records, signals, state_dir, status, task_dirs
from .liveness import InstanceRecord

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable

_KILL_S = 10.0
# The nodes of a host that is switched off do not refuse an answer, but never give it.
_FORGET_S = 10.0
_PROOF_S = 5.0
_SWEEP_S = 0.05
_EMPTY_SWEEPS = 2


def stop_task(request: Document) -> Document:
    """Stop one instance, or every living one where ``instance`` is null.

    ``stopped`` is replied only with proof.
    """
    began = time.monotonic()
    host, task = state_dir.check_name(request["host"]), state_dir.check_name(request["task"])
    if request.get("generation") is not None:
        status.check_generation(host, task, int(request["generation"]))
    if not request.get("keep_state"):
        task_dirs.drop_spools(host, task)
    alive = [record for record in liveness.read_instances(host, task) if liveness.is_alive(record)]
    wanted = [
        record for record in alive if request.get("instance") in (None, record.instance.get("instance"))
    ]
    lease_s = float(request.get("lease_s") or 0.0)
    if not wanted:
        graph = _clear_failure(host, task, lease_s) if not alive else {}
        left = [] if alive else _remove_containers(host, task)
        return _build_stop_reply(
            protocol.STOP_INCOMPLETE if left else protocol.NOT_RUNNING, left, began, graph
        )
    graph = {}
    left = [pid for record in wanted for pid in _stop_instance(record, request)]
    left += [] if left else _remove_containers(host, task)
    for record in wanted if not left else ():
        graph = nodes.forget_nodes(record.folder, lease_s) or graph
    return _build_stop_reply(protocol.STOP_INCOMPLETE if left else protocol.STOPPED, left, began, graph)


def _remove_containers(host: str, task: str) -> "list[int]":
    """Remove what its engine still has of a task that has no process; 0 where that cannot be proven."""
    folders = [each for each in state_dir.find_task_dirs(host, task) if os.path.exists(each + "/container")]
    if not folders:
        return []
    from ..containers.ending import remove_containers

    return [0 for folder in folders if remove_containers(folder)]


def forget_task_nodes(request: Document) -> Document:
    """Operation ``forget``: remove what the nodes of an instance that has ended have registered.

    Of a ``task`` of this host as its record has them; else ``nodes`` (name -> address) at ``master``, of a
    host that is gone.
    """
    if not request.get("task"):
        return {"graph": nodes.remove_nodes(str(request["master"]), request["nodes"], seconds=_FORGET_S)}
    record, alive = status.find_current(state_dir.check_name(request["host"]), request["task"])
    return {"graph": {} if record is None or alive else nodes.forget_nodes(record.folder, 0.0)}


def _build_stop_reply(state: str, left: "list[int]", began: float, graph: Document) -> Document:
    seconds = round(time.monotonic() - began, 3)
    return {"state": state, "left": sorted(left), "seconds": seconds, "graph": graph}


def _clear_failure(host: str, task: str, lease_s: float) -> Document:
    """Record a failed task that is stopped as stopped, so that its failure is no longer reported, and end the
    names of its nodes.
    """
    record, alive = status.find_current(host, task)
    if record is None or alive:
        return {}
    if record.status.get("state") in protocol.FAILED_STATES:
        _record_stopped(record)
    return nodes.forget_nodes(record.folder, lease_s)


def _record_stopped(record: InstanceRecord) -> None:
    now = liveness.read_instance(record.folder)
    if now.status.get("state") not in (protocol.STOPPED, protocol.COMPLETED):
        document = dict(
            now.status, instance=now.instance.get("instance"), state=protocol.STOPPED, pid=0, left=[]
        )
        records.write_record(os.path.join(record.folder, "status"), document)


def _stop_instance(record: InstanceRecord, request: Document) -> "list[int]":
    """Stop one instance; returns the pids that are left."""
    if request.get("generation") is not None:
        records.write_record(
            os.path.join(record.folder, "generation"),
            {"generation": int(request["generation"])},
            durable=True,
        )
    settings = request.get("stop") or record.instance.get("stop") or {}
    note = nodes.note_nodes(record.folder)
    disable_restarts(record)
    if lockfile.is_lock_held(record.folder, "switch"):
        # Imported on demand: few tasks have an activation.
        from .switch_lock import end_switch

        end_switch(record.folder)
    for name, scope, grace_s in signals.list_stop_steps(settings):
        if _signal_until_gone(record, signals.parse_signal(name), scope, grace_s, note):
            break
    _signal_until_gone(record, signals.parse_signal("KILL"), "tree", _KILL_S, note)
    left = _find_remaining(record)
    if not left:
        _record_stopped(record)
    return left


def disable_restarts(record: InstanceRecord) -> None:
    """Ask the supervisor not to restart the task; it stays to reap the tree."""
    above = liveness.find_supervisor(record)
    if above:
        ticks = record.instance["supervisor_ticks"]
        signals.send_signal(above, ticks, signals.parse_signal("TERM"))
        signals.send_signal(above, ticks, signals.parse_signal("CONT"))


def _signal_until_gone(
    record: InstanceRecord, number: int, scope: str, patience_s: float, note: "Callable[[set[int]], None]"
) -> bool:
    """Signal, then sweep until two sweeps in a row find nothing; newcomers get the signal too. ``note`` is
    called with the processes of each sweep.

    False after ``patience_s``.
    """
    deadline, empty = time.monotonic() + patience_s, 0
    sent: "set[tuple[int, int, int]]" = set()
    while empty < _EMPTY_SWEEPS:
        table = proc.read_process_table()
        record = liveness.read_instance(record.folder)
        pids = liveness.find_processes(record, table)
        empty = 0 if pids else empty + 1
        note(pids)
        if pids and os.path.exists(record.folder + "/container"):
            from ..containers.ending import signal_step

            sent |= signal_step(record.folder, number, pids, table, sent)
            if time.monotonic() >= deadline:
                return False
            time.sleep(_SWEEP_S)
            continue
        targets = (
            pids
            if scope == "tree"
            else {signals.find_main_process(record.status.get("pid", 0), table)} & pids
        )
        if scope == "tree" or not sent:
            sent |= signals.send_signals([(pid, table[pid].ticks) for pid in sorted(targets)], number, sent)
        if pids and time.monotonic() >= deadline:
            return False
        time.sleep(_SWEEP_S)
    return True


def _find_remaining(record: InstanceRecord) -> "list[int]":
    """Find the remaining pids; empty where the lock is free and no process carries cookie or lock."""
    deadline = time.monotonic() + _PROOF_S
    while time.monotonic() < deadline:
        found = liveness.read_instance(record.folder)
        above = liveness.find_supervisor(found)
        left = liveness.find_processes(found, proc.read_process_table())
        if not above and not left and not found.locked:
            return []
        time.sleep(_SWEEP_S)
    if above and not left:
        # The tree is gone but the supervisor keeps the lock: it is ours and no longer needed.
        signals.send_signal(above, record.instance["supervisor_ticks"], signals.parse_signal("KILL"))
        time.sleep(2 * _SWEEP_S)
        found = liveness.read_instance(record.folder)
        above, left = (
            liveness.find_supervisor(found),
            liveness.find_processes(found, proc.read_process_table()),
        )
    return sorted(left | ({above} if above else set())) or (
        [0] if lockfile.is_lock_held(record.folder) else []
    )
