# SPDX-License-Identifier: Apache-2.0
"""Removal of containers whose tasks have ended: those that a loss of power has ended, and those that the
engine could not remove when they ended.

A task that runs elsewhere by then is neither started nor stopped on this host again, so that nothing else
would remove them. Their output is in the logs of the task.
"""

import os

from ..supervise import liveness, lockfile
from ..supervise.spawn import run_detached
from . import ending, engine, record


def begin_removal(folders: "list[str]") -> None:
    """Remove, in a process of its own, what engines still have of those tasks in ``folders`` that are dead.

    What cannot be removed now is tried again at the next probe of a manager that has the fleet.
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
