# SPDX-License-Identifier: Apache-2.0
"""Removal of containers whose tasks have ended: those that a loss of power has ended, and those that the
engine could not remove when they ended.

A task that runs elsewhere by then is neither started nor stopped on this host again, so that nothing else
would remove them. Their output is in the logs of the task.
"""

import os
import time

from ..link.fast_json import Document
from ..supervise import liveness, lockfile, state_dir
from ..supervise.launch import run_detached
from . import create, ending, engine, record

# The engine may hang, but no request waits for it, and a start only for so long.
_AWAITED_S, _POLL_S = 20.0, 0.05


def begin_removal(folders: "list[str]") -> None:
    """Remove, in a process of its own, what engines still have of those tasks in ``folders`` that are dead.

    What cannot be removed now is tried again at the next request.
    """
    dead = [each for each in folders if not lockfile.is_lock_held(each, lockfile.GUARD)]
    if not dead:
        return
    try:
        null = os.open(os.devnull, os.O_WRONLY)
        run_detached(lambda: _remove_all_dead(dead), null, (null,))
    except OSError:
        pass


def _remove_all_dead(folders: "list[str]") -> None:
    for folder in folders:
        _remove_if_dead(folder)


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
    return engine.call_engine([program, "rm", "--volumes", *lost], ending.REMOVE_S).kind == engine.DONE


def _is_own_place(folder: str) -> bool:
    return any(folder.startswith(base + "/") for base in state_dir.list_own_bases())


def await_removal(folder: str) -> None:
    """Wait until nobody removes containers of the task: its new one would have the name of the old one."""
    deadline = time.monotonic() + _AWAITED_S
    while lockfile.is_lock_held(folder, lockfile.GUARD) and time.monotonic() < deadline:
        time.sleep(_POLL_S)


def _remove_if_dead(folder: str) -> None:
    """Remove the containers of the task in ``folder``, unless it lives.

    Meanwhile no supervisor takes the task over, which needs the exit code of its container, and a start that
    has taken the lock of the task waits before it creates one.
    """
    try:
        guard = lockfile.take_lock(folder, lockfile.GUARD)
    except OSError:
        return
    if guard < 0:
        return
    try:
        if not liveness.is_alive(liveness.read_instance(folder)):
            _remove_dead(folder)
    finally:
        os.close(guard)


def _remove_dead(folder: str) -> None:
    """Remove what is in no use: the engine itself refuses to remove what runs, as force is not asked for."""
    found = record.read_container(folder)
    program = str(found.get("program") or "")
    ids, call = ending.list_containers(program, folder)
    if ids:
        engine.call_engine([program, "rm", "--volumes", *ids], ending.REMOVE_S)
        ids, call = ending.list_containers(program, folder)
    if call.kind == engine.DONE and not ids:
        record.note_removal(folder, found)
