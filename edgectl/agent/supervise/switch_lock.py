# SPDX-License-Identifier: Apache-2.0
"""Lock of changes of the role of a task: held by the request or the supervisor that makes one.

Its command inherits it, so that nothing else changes the role while a command lives whose agent was killed.
"""

import fcntl
import os
import time

from ..link.errors import RefusalError
from ..measure import proc
from . import lockfile, records, signals

NAME = "switch"
_TRY_S = 0.002
_KILL_S = 2.0


def open_switch_lock(folder: str) -> int:
    """Open the lock of changes of the role, without taking it: a command that inherits the descriptor holds
    the lock from the moment on when it is taken, and for as long as it lives.
    """
    return records.open_private_file(os.path.join(folder, NAME), os.O_RDWR | os.O_CREAT)


def take_switch_lock(lock: int, patience_s: float) -> bool:
    """Take an open lock; False where it is held for longer than the patience."""
    deadline = time.monotonic() + patience_s
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            if time.monotonic() >= deadline:
                return False
            time.sleep(_TRY_S)
        else:
            return True


def end_switch(folder: str) -> None:
    """Before a stop: kill an activation or deactivation that is under way, so that it does nothing later.

    Raises:
        RefusalError: it cannot be killed.
    """
    deadline = time.monotonic() + _KILL_S
    while lockfile.is_lock_held(folder, NAME):
        is_late = time.monotonic() >= deadline
        table = proc.read_process_table()
        # Who began another first: it would go on when that ends, as a request that undoes its activation.
        holders = lockfile.find_lock_holders(folder, table, NAME)
        for pid in sorted(holders, key=lambda pid: (table[pid].ticks, pid)):
            signals.send_signal(pid, table[pid].ticks, signals.parse_signal("KILL"))
        if is_late:
            raise RefusalError("busy", "an activation is under way and cannot be killed", "apply again")
        time.sleep(_TRY_S)
