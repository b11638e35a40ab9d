"""Where the host keeps what it knows: BASE/hosts/HOST/tasks/TASK, all 0700, files 0600, no links followed.

``BASES`` is set once per request: the usual place first, then shared memory for homes that cannot be written.
"""

import os

from .boot import check_private, private_dir
from .errors import RefusalError
from .record import SIZE, open_private

BASES = []
_LETTERS = frozenset("abcdefghijklmnopqrstuvwxyz0123456789._-")
_LONGEST_NAME = 63


def _is_name(name) -> bool:
    return (
        isinstance(name, str)
        and 0 < len(name) <= _LONGEST_NAME
        and name[0] not in "._-"
        and _LETTERS.issuperset(name)
    )


def checked_name(name: str) -> str:
    """``name`` where it is safe as a file name. Raises RefusalError."""
    if not _is_name(name):
        raise RefusalError("bad-name", "not a name: %r" % (name,), "names match [a-z0-9][a-z0-9._-]{0,62}")
    return name


def _levels(base: str, host: str, task: str) -> list:
    hosts = os.path.join(base, "hosts")
    home = os.path.join(hosts, checked_name(host))
    tasks = os.path.join(home, "tasks")
    return [base, hosts, home, tasks, os.path.join(tasks, checked_name(task))]


def task_dirs(host: str, task: str) -> list:
    """The directories in which ``task`` has left traces, best first."""
    found = []
    for base in BASES:
        levels = _levels(base, host, task)
        if os.path.isdir(levels[-1]):
            for level in levels:
                check_private(level)
            found.append(levels[-1])
    return found


def host_places(host: str) -> list:
    """For each base the directories down to that of ``host``, whether they are there or not."""
    return [_levels(base, host, host)[:3] for base in BASES]


def task_names(host: str) -> list:
    """Every task that has left traces on this host, sorted."""
    names = set()
    for base in BASES:
        folder = os.path.join(base, "hosts", checked_name(host), "tasks")
        if os.path.isdir(folder):
            names.update(name for name in os.listdir(folder) if _is_name(name))
    return sorted(names)


def make_task_dir(host: str, task: str) -> str:
    """The directory in which to start ``task``: the first place that takes a directory and its fixed-size files.

    Raises:
        RefusalError: no place can be written.
    """
    reasons = []
    for base in BASES:
        levels = _levels(base, host, task)
        try:
            for level in levels:
                private_dir(level)
            for name, size in (
                ("lock", 0),
                ("instance", SIZE),
                ("status", SIZE),
                ("mark", SIZE),
                ("generation", SIZE),
            ):
                reserve(os.path.join(levels[-1], name), size)
            return levels[-1]
        except OSError as error:
            reasons.append("%s: %s" % (base, error.strerror or error))
    raise RefusalError(
        "no-state-dir",
        "no place to keep the task's state: " + "; ".join(reasons),
        "free some disk space or set EDGECTL_STATE_DIR",
    )


def reserve(path: str, size: int) -> None:
    """Create ``path`` with ``size`` bytes really allocated, so that a disk that fills up later cannot stop a rewrite."""
    fd = open_private(path, os.O_RDWR | os.O_CREAT)
    try:
        have = os.fstat(fd).st_size
        if have < size:
            os.pwrite(fd, b" " * (size - have), have)
    finally:
        os.close(fd)
