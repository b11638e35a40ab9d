# SPDX-License-Identifier: Apache-2.0
"""State directory of this host: BASE/agent-state/FLEET/hosts/HOST/tasks/TASK, directories 0700, files 0600,
no links followed.

``BASES`` and the fleet are set once per request: the usual directory first, then shared memory for homes that
cannot be written. Every fleet has a directory of its own, so tasks of one are never those of another.

The first release kept tasks in BASE/hosts/HOST/tasks/TASK, without a fleet. Those that a fleet has adopted
(``adoption.py``) are found there.
"""

import os

from ..link import protocol
from ..link.boot import check_private_dir, is_dir, is_own_dir
from ..link.errors import RefusalError
from .records import read_record

BASES: "list[str]" = []
ROOT_NAME, OWNER_FILE_NAME, ADOPTION_FILE_NAME = "agent-state", "fleet", "adopted"
FORMER_NAMES_FILE_NAME = "former"
# The state of a task on its way to another host, in the directory of the task.
SPOOL_FILE_NAME = "state"
_FLEET: "list[str]" = ["unnamed"]


def use_fleet(bases: "list[str]", fleet: object) -> None:
    """Set the bases and the fleet of this request. Raises RefusalError."""
    BASES[:] = bases
    _FLEET[:] = [check_name(fleet)]


def get_fleet() -> str:
    """Get the fleet of this request."""
    return _FLEET[0]


def check_name(name: object) -> str:
    """Return ``name`` where it is safe as a file name. Raises RefusalError."""
    if not protocol.is_name(name):
        raise RefusalError("bad-name", "not a name: %r" % (name,), "names match " + protocol.NAME_PATTERN)
    return str(name)


def list_fleet_levels(base: str) -> "list[str]":
    """List the directories from ``base`` down to that of this fleet, existing or not."""
    root = base + "/" + ROOT_NAME
    return [base, root, root + "/" + get_fleet()]


def find_host_dir(base: str, host: str) -> str:
    """Find the directory of ``host`` below ``base``, existing or not."""
    return "%s/%s/%s/hosts/%s" % (base, ROOT_NAME, get_fleet(), check_name(host))


def _list_host_levels(base: str, host: str) -> "list[str]":
    levels = list_fleet_levels(base)
    hosts = levels[-1] + "/hosts"
    return [*levels, hosts, hosts + "/" + check_name(host)]


def list_levels(base: str, host: str, task: str) -> "list[str]":
    """List the directories from ``base`` down to that of ``task``, existing or not."""
    levels = _list_host_levels(base, host)
    tasks = levels[-1] + "/tasks"
    return [*levels, tasks, tasks + "/" + check_name(task)]


def list_legacy_levels(base: str, host: str) -> "list[str]":
    """List the directories down to that of the tasks of ``host`` in the layout without fleets."""
    home = base + "/hosts/" + check_name(host)
    return [base, base + "/hosts", home, home + "/tasks"]


def list_host_names(host: str) -> "list[str]":
    """List ``host``, then the former names of this machine whose tasks are its tasks (``adoption.py``).

    Shared memory counts first: it has a record only where the usual directory could not be written.
    """
    for base in reversed(BASES):
        path = "%s/%s" % (find_host_dir(base, host), FORMER_NAMES_FILE_NAME)
        # The cheapest question comes first: few hosts have such a file.
        if os.access(path, os.F_OK) and not is_foreign_base(base):
            names = read_record(path).get("names", [])
            if names:
                return [host, *(name for name in names if protocol.is_name(name) and name != host)]
    return [check_name(host)]


def list_adopted_dirs(host: str) -> "list[str]":
    """List the directories in the layout without fleets whose tasks this fleet has adopted."""
    marks = ["%s/%s" % (find_host_dir(base, host), ADOPTION_FILE_NAME) for base in BASES]
    if not any(os.access(mark, os.F_OK) for mark in marks):
        return []
    found = []
    for base in list_own_bases():
        tasks = list_legacy_levels(base, host)[-1]
        names = sorted(os.listdir(tasks)) if is_dir(tasks) else []
        found += [
            os.path.join(tasks, name)
            for name in names
            if protocol.is_name(name) and read_owner(os.path.join(tasks, name)) == get_fleet()
        ]
    return found


def read_owner(folder: str) -> str:
    """Read the fleet that adopted the task in ``folder``; empty where none did."""
    return str(read_record(os.path.join(folder, OWNER_FILE_NAME)).get("fleet", ""))


def list_own_bases() -> "list[str]":
    """List the bases that can hold anything of this user: not those that somebody else has put there."""
    return [base for base in BASES if not is_foreign_base(base)]


def is_foreign_base(base: str) -> bool:
    """Whether ``base`` exists and is a link, no directory, or of another user.

    In shared memory any user can create it first; nothing of ours is ever in it.
    """
    try:
        info = os.lstat(base)
    except OSError:
        return False
    return not is_own_dir(info)


def find_task_dirs(host: str, task: str) -> "list[str]":
    """Find the existing directories of ``task``, best first; those of former names of the host last."""
    return [folder for name in list_host_names(host) for folder in find_task_dirs_of_name(name, task)]


def find_task_dirs_of_name(host: str, task: str) -> "list[str]":
    """Find the existing directories of ``task`` under this name of the host, best first."""
    found = []
    for base in list_own_bases():
        levels = list_levels(base, host, task)
        if is_dir(levels[-1]):
            for level in levels:
                check_private_dir(level)
            found.append(levels[-1])
    return found + [folder for folder in list_adopted_dirs(host) if os.path.basename(folder) == task]


def list_host_dirs(host: str) -> "list[list[str]]":
    """List, for each base, the directories down to that of ``host``, existing or not."""
    return [_list_host_levels(base, host) for base in BASES]


def list_task_names(host: str) -> "list[str]":
    """List every task of this fleet with a directory on this host, under any of its names, sorted."""
    names: "set[str]" = set()
    for known in list_host_names(host):
        names.update(os.path.basename(folder) for folder in list_adopted_dirs(known))
        for folder in list_tasks_dirs(known):
            names.update(name for name in os.listdir(folder) if protocol.is_name(name))
    return sorted(names)


def list_tasks_dirs(host: str) -> "list[str]":
    """List the existing directories that have one directory for each task of ``host``."""
    found = [(base, find_host_dir(base, host) + "/tasks") for base in BASES]
    return [folder for base, folder in found if is_dir(folder) and not is_foreign_base(base)]
