# SPDX-License-Identifier: Apache-2.0
"""Signals to a container, and the proof that it is gone.

The engine passes a signal on: only it may where the container runs as another user. Where it does not
answer, the processes are signalled themselves, which suffices for those of this user. Only what carries the
task's own directory in a label is ever removed.
"""

import os
import time

from ..link.fast_json import Document
from ..measure import proc
from ..supervise import liveness, signals
from . import create, engine, record

_REMOVE_S, _AGAIN_S = 30.0, 0.2
_KILL = signals.parse_signal("KILL")


def signal_step(
    folder: str,
    number: int,
    left: "set[int]",
    table: "dict[int, proc.Process]",
    sent: "set[tuple[int, int, int]]",
) -> "set[tuple[int, int, int]]":
    """Send one step of a stop to what is left of the task in ``folder``; returns what was sent, as
    `signals.send_signals`.

    What follows the container from outside ends with it; it is killed in the last step, or where it waits for
    an engine that is gone, or for a swarm to start the container.
    """
    found = record.read_container(folder)
    inside = record.find_processes_by_id(str(found.get("id") or ""), table) & left
    done: "set[tuple[int, int, int]]" = set()
    if not inside:
        if number != _KILL and not (found.get("lost") or found.get("pending")):
            return done
        return signals.send_signals([(pid, table[pid].ticks) for pid in sorted(left)], _KILL, sent)
    # Once for each signal, and again only to what the engine could not be asked for.
    mark = (0, 0, number)
    delivered = mark in sent or _deliver_signal(found, number)
    if delivered:
        done.add(mark)
    if not delivered or number == _KILL:
        done |= signals.send_signals([(pid, table[pid].ticks) for pid in sorted(inside)], number, sent)
    return done


def _deliver_signal(found: Document, number: int) -> bool:
    """Have the engine signal the container. podman's own init passes nothing on to a group."""
    if os.path.basename(str(found["program"])) == "podman" and number != _KILL:
        return False
    call = engine.call_engine([str(found["program"]), "kill", "--signal", str(number), str(found["id"])])
    return call.kind in (engine.DONE, engine.GONE)


def remove_containers(folder: str, program: str = "") -> str:
    """Remove every container of the task in ``folder``: empty with proof that none can run, else why not.

    The caller has seen that no process is left, or keeps the lock of the task.
    """
    found = record.read_container(folder)
    program = program or str(found.get("program") or "")
    if not program:
        return ""
    if found.get("place"):
        from .swarm import remove_service

        why = remove_service(folder)
        if why:
            return why
    deadline = time.monotonic() + _REMOVE_S
    while True:
        ids, call = list_containers(program, folder)
        if call.kind == engine.LOST and call.refused:
            # Nothing listens: what is dead starts nothing, and what comes back restarts no container of ours.
            return ""
        if call.kind != engine.DONE:
            return call.why
        if not ids:
            return ""
        last = engine.call_engine([program, "rm", "--force", "--volumes", *ids], _REMOVE_S)
        if time.monotonic() > deadline:
            return last.why or "the container is still there"
        if last.kind != engine.DONE:
            # A swarm removes the container of its service itself.
            time.sleep(_AGAIN_S)


def list_containers(program: str, folder: str) -> "tuple[list[str], engine.EngineCall]":
    """List the ids of the containers that carry the directory of the task, running or not."""
    mark = "label=%s=%s" % (create.DIR_LABEL, folder)
    call = engine.call_engine([program, "ps", "--all", "--quiet", "--no-trunc", "--filter", mark])
    return call.out.split(), call


def end_followers(folder: str) -> None:
    """Kill what follows the container of an orphan from outside; its new supervisor follows it anew."""
    known = record.read_container(folder)
    if known.get("pending"):
        # A swarm may have started it since; else it would pass for what follows it.
        ids = list_containers(str(known["program"]), folder)[0]
        record.write_container(folder, dict(known, id=ids[0] if ids else ""), durable=True)
    table = proc.read_process_table()
    found = liveness.find_orphans(liveness.read_instance(folder), table)
    outside = found - record.find_container_processes(folder, table)
    signals.send_signals([(pid, table[pid].ticks) for pid in sorted(outside)], _KILL, set())
