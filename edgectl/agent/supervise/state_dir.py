"""State directory of this host: BASE/hosts/HOST/tasks/TASK, directories 0700, files 0600, no links followed.

``BASES`` is set once per request: the usual directory first, then shared memory for homes that cannot be
written.
"""

import os

from ..link import protocol
from ..link.boot import check_private_dir, make_private_dir
from ..link.errors import RefusalError
from .records import RECORD_BYTES, open_private_file

BASES: "list[str]" = []


def check_name(name: object) -> str:
    """Return ``name`` where it is safe as a file name. Raises RefusalError."""
    if not protocol.is_name(name):
        raise RefusalError("bad-name", "not a name: %r" % (name,), "names match " + protocol.NAME_PATTERN)
    return str(name)


def _list_levels(base: str, host: str, task: str) -> "list[str]":
    hosts = os.path.join(base, "hosts")
    home = os.path.join(hosts, check_name(host))
    tasks = os.path.join(home, "tasks")
    return [base, hosts, home, tasks, os.path.join(tasks, check_name(task))]


def find_task_dirs(host: str, task: str) -> "list[str]":
    """Find the existing directories of ``task``, best first."""
    found = []
    for base in BASES:
        levels = _list_levels(base, host, task)
        if os.path.isdir(levels[-1]):
            for level in levels:
                check_private_dir(level)
            found.append(levels[-1])
    return found


def list_host_dirs(host: str) -> "list[list[str]]":
    """List, for each base, the directories down to that of ``host``, existing or not."""
    return [_list_levels(base, host, host)[:3] for base in BASES]


def list_task_names(host: str) -> "list[str]":
    """List every task with a directory on this host, sorted."""
    names: "set[str]" = set()
    for base in BASES:
        folder = os.path.join(base, "hosts", check_name(host), "tasks")
        if os.path.isdir(folder):
            names.update(name for name in os.listdir(folder) if protocol.is_name(name))
    return sorted(names)


def make_task_dir(host: str, task: str) -> str:
    """Create the directory of ``task`` in the first base that accepts it and its fixed-size files.

    Raises:
        RefusalError: no base can be written.
    """
    reasons = []
    for base in BASES:
        levels = _list_levels(base, host, task)
        try:
            for level in levels:
                make_private_dir(level)
            for name, size in (
                ("lock", 0),
                ("instance", RECORD_BYTES),
                ("status", RECORD_BYTES),
                ("mark", RECORD_BYTES),
                ("generation", RECORD_BYTES),
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
