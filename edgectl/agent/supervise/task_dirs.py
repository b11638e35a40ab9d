# SPDX-License-Identifier: Apache-2.0
"""Directories of tasks as few requests need them: made, searched by a file in them, cleared of states.

Apart from ``state_dir.py``, which every request loads.
"""

import os

from ..link import protocol
from ..link.boot import make_private_dir
from ..link.errors import RefusalError
from . import state_dir
from .records import RECORD_BYTES, open_private_file


def make_task_dir(host: str, task: str) -> str:
    """Create the directory of ``task`` in the first base that accepts it and its fixed-size files.

    Raises:
        RefusalError: no base can be written.
    """
    reasons = []
    for base in state_dir.BASES:
        levels = state_dir.list_levels(base, host, task)
        try:
            for level in levels:
                make_private_dir(level)
            for name, size in (
                ("lock", 0),
                ("instance", RECORD_BYTES),
                ("status", RECORD_BYTES),
                ("mark", RECORD_BYTES),
                ("generation", RECORD_BYTES),
                ("role", RECORD_BYTES),
                ("switch", 0),
            ):
                reserve_file(os.path.join(levels[-1], name), size)
            return levels[-1]
        except OSError as error:
            reasons.append("%s: %s" % (base, error.strerror or error))
    raise RefusalError(
        "no-state-dir",
        "no place to keep the task's state: " + "; ".join(reasons),
        "free some disk space or set EDGECTL_STATE_DIR",
    )


def reserve_file(path: str, size: int) -> None:
    """Create ``path`` with ``size`` bytes allocated, so that a disk that fills up later cannot stop a
    rewrite.
    """
    fd = open_private_file(path, os.O_RDWR | os.O_CREAT)
    try:
        have = os.fstat(fd).st_size
        if have < size:
            os.pwrite(fd, b" " * (size - have), have)
    finally:
        os.close(fd)


def drop_spools(host: str, task: str) -> bool:
    """Remove what is left here of the state of ``task``; False where there was nothing."""
    dropped = False
    for folder in state_dir.find_task_dirs(host, task):
        try:
            os.unlink(os.path.join(folder, state_dir.SPOOL_FILE_NAME))
            dropped = True
        except FileNotFoundError:
            continue
    return dropped


def find_task_dirs_with(host: str, file_name: str) -> "list[str]":
    """Find the directories of tasks of this host, under any of its names, that have a file of this name."""
    return [
        folder
        for known in state_dir.list_host_names(host)
        for tasks in state_dir.list_tasks_dirs(known)
        for task in sorted(os.listdir(tasks))
        if protocol.is_name(task) and os.path.exists("%s/%s/%s" % (tasks, task, file_name))
        for folder in state_dir.find_task_dirs_of_name(known, task)
        if os.path.dirname(folder) == tasks
    ]
