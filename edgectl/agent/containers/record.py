# SPDX-License-Identifier: Apache-2.0
"""Record of the container of a task, beside its other records, and the processes in that container.

The engine starts a container, so it is in no process tree of ours; the id of the container, which the kernel
has in the control group of each of its processes, tells them from all others.
"""

import os

from ..link.fast_json import Document
from ..measure import proc, system_files
from ..supervise import records

FILE_NAME = "container"
# Of which run the engine has nothing more.
_REMOVED_NAME = "container-removed"
_ID_LENGTH = 64


def has_container(folder: str) -> bool:
    """Whether the task in ``folder`` ever ran in a container."""
    return os.path.exists(os.path.join(folder, FILE_NAME))


def read_container(folder: str) -> Document:
    """Read the record: ``id``, ``name`` and ``program`` of the engine; ``run``, another one for each
    container; ``pid`` and ``ticks`` of its first process once it was started; ``lost`` while the engine does
    not answer. Empty without a container.

    Of a service of a swarm: its ``place`` until it is removed, and ``pending`` while it may start.
    """
    return records.read_record(os.path.join(folder, FILE_NAME))


def may_start(folder: str) -> bool:
    """Whether a swarm was asked for the container and may start it, although nothing of it is seen yet."""
    return bool(read_container(folder).get("pending"))


def write_container(folder: str, document: Document, *, durable: bool = False) -> None:
    """Replace the record."""
    records.write_record(os.path.join(folder, FILE_NAME), document, durable=durable)


def note_removal(folder: str, found: Document) -> None:
    """Note that the engine has nothing more of the container that the record ``found`` describes, so that it
    is not asked again. A service may be left in its swarm all the same.
    """
    if read_container(folder).get("place"):
        return
    try:
        records.write_record(os.path.join(folder, _REMOVED_NAME), {"run": found.get("run", "")})
    except OSError:
        pass


def may_be_left(folder: str) -> bool:
    """Whether the engine may still have the container of the last run."""
    found = read_container(folder)
    removed = records.read_record(os.path.join(folder, _REMOVED_NAME))
    return bool(found) and removed.get("run") != found.get("run", "")


def describe_container(folder: str) -> Document:
    """Describe the container of a living task for its entry: ``engine`` and ``container``, its name."""
    found = read_container(folder)
    return {
        "engine": os.path.basename(str(found.get("program") or "")),
        "container": str(found.get("name") or "") if found.get("id") else "",
    }


def find_container_processes(folder: str, table: "dict[int, proc.Process]") -> "set[int]":
    """Find the processes in the container of the task in ``folder``."""
    return find_processes_by_id(str(read_container(folder).get("id") or ""), table)


def find_processes_by_id(container_id: str, table: "dict[int, proc.Process]") -> "set[int]":
    """Find the processes whose control group is that of the container, or below it."""
    if len(container_id) != _ID_LENGTH:
        return set()
    # podman has a group of its own for the process that watches the container.
    word, watcher = container_id.encode(), b"conmon-" + container_id.encode()
    groups = ((pid, system_files.read_file("/proc/%d/cgroup" % pid)) for pid in table)
    return {pid for pid, text in groups if word in text and watcher not in text}


def find_first_process(pids: "set[int]", table: "dict[int, proc.Process]") -> "tuple[int, int]":
    """Find (pid, start ticks) of the process that the engine started; (0, -1) where there is none."""
    above = [pid for pid in pids if pid in table and table[pid].ppid not in pids]
    if not above:
        return 0, -1
    first = min(above, key=lambda pid: (table[pid].ticks, pid))
    return first, table[first].ticks
