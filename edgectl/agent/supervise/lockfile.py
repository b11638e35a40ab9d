# SPDX-License-Identifier: Apache-2.0
"""Lock of a task or profiler: taken by its supervisor, inherited by its processes."""

import os
import time

from ..measure import proc, system_files
from . import records

# A test of the lock (is_lock_held) takes some microseconds; a holder beyond these tries is a supervisor.
_TRIES = 10
_TRY_S = 0.03
# Held by the supervisor of a task that was taken over, and while the container of a dead one is removed.
GUARD = "takeover"


def take_lock(folder: str, name: str = "lock") -> int:
    """Take the lock; its descriptor, or -1 where the holder lives."""
    import fcntl

    fd = records.open_private_file(os.path.join(folder, name), os.O_RDWR | os.O_CREAT)
    for _ in range(_TRIES):
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            time.sleep(_TRY_S)
        else:
            return fd
    os.close(fd)
    return -1


def is_lock_held(folder: str, name: str = "lock") -> bool:
    """Whether a process holds the lock.

    Tested with a shared lock, so that two tests do not see each other.
    """
    try:
        fd = records.open_private_file(os.path.join(folder, name), os.O_RDONLY)
    except FileNotFoundError:
        return False
    # A library that a request about no task does without.
    import fcntl

    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(fd)
    return False


def find_lock_holders(folder: str, table: "dict[int, proc.Process]", name: str = "lock") -> "set[int]":
    """Find the pids that hold the lock: the last evidence where even the environment was emptied."""
    path = os.path.join(folder, name)
    try:
        wanted = os.stat(path)
    except OSError:
        return set()
    return {pid for pid in table if pid != os.getpid() and _has_lock_open(pid, wanted)}


def _has_lock_open(pid: int, wanted: os.stat_result) -> bool:
    """Whether the process can hold the lock.

    An open descriptor is not enough: an agent that tests the lock has one for a moment.
    """
    folder = "/proc/%d/fd/" % pid
    try:
        for name in os.listdir(folder):
            info = os.stat(folder + name)
            same = (info.st_dev, info.st_ino) == (wanted.st_dev, wanted.st_ino)
            if same and b"WRITE" in system_files.read_file("/proc/%d/fdinfo/%s" % (pid, name)):
                return True
    except OSError:
        pass
    return False
