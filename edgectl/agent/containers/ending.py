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
from ..supervise import liveness, lockfile, signals, state_dir
from . import create, engine, record

REMOVE_S = 30.0
_TRIES, _TRY_S = 5, 0.2
# The engine may hang in a removal beside a request, but a start waits only for so long.
_AWAITED_S, _POLL_S = 20.0, 0.05
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
    an engine that is gone.
    """
    found = record.read_container(folder)
    inside = record.find_processes_by_id(str(found.get("id") or ""), table) & left
    done: "set[tuple[int, int, int]]" = set()
    if not inside:
        if number != _KILL and not found.get("lost"):
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
    for number in range(_TRIES):
        # One that the engine is just removing is refused, and still listed.
        time.sleep(_TRY_S if number else 0.0)
        ids, call = list_containers(program, folder)
        if call.kind == engine.LOST and call.refused:
            # Nothing listens: what is dead starts nothing, and what comes back restarts no container of ours.
            return ""
        if call.kind != engine.DONE:
            return call.why
        if not ids:
            record.note_removal(folder, found)
            return ""
        last = engine.call_engine([program, "rm", "--force", "--volumes", *ids], REMOVE_S)
    return last.why or "the container is still there"


def list_containers(program: str, folder: str) -> "tuple[list[str], engine.EngineCall]":
    """List the ids of the containers that carry the directory of the task, running or not."""
    mark = "label=%s=%s" % (create.DIR_LABEL, folder)
    call = engine.call_engine([program, "ps", "--all", "--quiet", "--no-trunc", "--filter", mark])
    return call.out.split(), call


def remove_lost(program: str, identity: Document) -> bool:
    """Remove the dead container of the task whose record is gone, as one in shared memory is after a loss of
    power; whether there was one. That of another user or fleet never had a record in a base of this one.
    """
    marks = ["label=%s%s=%s" % (create.LABEL, name, identity[name]) for name in ("fleet", "host", "task")]
    filters = [word for mark in marks for word in ("--filter", mark)]
    form = '{{.ID}} {{.Label "%s"}}' % create.DIR_LABEL
    call = engine.call_engine([program, "ps", "--all", "--no-trunc", *filters, "--format", form])
    lines = [line.partition(" ") for line in call.out.splitlines()]
    lost = [found for found, _, folder in lines if _is_own_place(folder) and not os.path.lexists(folder)]
    if not lost:
        return False
    return engine.call_engine([program, "rm", "--volumes", *lost], REMOVE_S).kind == engine.DONE


def _is_own_place(folder: str) -> bool:
    return any(folder.startswith(base + "/") for base in state_dir.list_own_bases())


def await_removal(folder: str) -> None:
    """Wait until nobody removes containers of the task: its new one would have the name of the old one."""
    deadline = time.monotonic() + _AWAITED_S
    while lockfile.is_lock_held(folder, lockfile.GUARD) and time.monotonic() < deadline:
        time.sleep(_POLL_S)


def end_followers(folder: str) -> None:
    """Kill what follows the container of an orphan from outside; its new supervisor follows it anew."""
    table = proc.read_process_table()
    found = liveness.find_orphans(liveness.read_instance(folder), table)
    outside = found - record.find_container_processes(folder, table)
    signals.send_signals([(pid, table[pid].ticks) for pid in sorted(outside)], _KILL, set())
