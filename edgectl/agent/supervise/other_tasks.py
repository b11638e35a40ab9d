# SPDX-License-Identifier: Apache-2.0
"""Living tasks on this machine that are not those of the host of this request: of this fleet under another
host name, and of other fleets. They are listed and never touched.
"""

import os

from ..link import protocol
from ..link.boot import is_own_dir
from ..link.fast_json import Document
from . import state_dir

TYPE_CHECKING = False
if TYPE_CHECKING:
    from ..measure import proc
    from .liveness import InstanceRecord

# Room in a reply; those of this fleet come first.
_MAX_ENTRIES = 1000


def list_other_tasks(host: str, table: "dict[int, proc.Process] | None" = None) -> "list[Document]":
    """List an entry of each: fleet (empty for one of the first release that none has adopted), host, task,
    state, age, instance, spec, generation, and the manager that started it.
    """
    folders = _list_task_dirs()
    if not folders:
        return []
    from ..measure import proc
    from . import liveness

    own, names, found = state_dir.get_fleet(), state_dir.list_host_names(host), []
    for fleet, filed_under, folder in folders:
        known = fleet == own and filed_under in names
        if (
            (filed_under != host or not known)
            and liveness.may_live(folder)
            and not (known and _is_shown(host, folder))
        ):
            record = liveness.read_instance(folder)
            if not record.locked and table is None:
                table = proc.read_process_table()
            # Its lock is held before its record is written, and after it is removed.
            if record.instance and liveness.is_alive(record, table):
                found.append(_build_other_entry(fleet, filed_under, record))
    found.sort(key=lambda each: (each["fleet"] != own, each["fleet"], each["host"], each["task"]))
    return found[:_MAX_ENTRIES]


def _is_shown(host: str, folder: str) -> bool:
    """Whether the entry of the host for this task is that of ``folder``."""
    from .status import find_current

    record = find_current(host, os.path.basename(folder))[0]
    return record is not None and record.folder == folder


def _build_other_entry(fleet: str, host: str, record: "InstanceRecord") -> Document:
    from .liveness import build_entry

    entry = build_entry(record, alive=True)
    return {
        "fleet": fleet,
        "host": host,
        "task": os.path.basename(record.folder),
        "started_by": record.instance.get("manager", ""),
        "state": entry["state"],
        "age_s": entry["age_s"],
        "instance": entry["instance"],
        "spec_hash": entry["spec_hash"],
        "generation": entry["generation"],
    }


def _list_task_dirs() -> "list[tuple[str, str, str]]":
    """List (fleet, host, directory) of every task on this machine."""
    found = []
    for base in state_dir.list_own_bases():
        root = base + "/" + state_dir.ROOT_NAME
        for fleet in _list_names(root):
            hosts = "%s/%s/hosts" % (root, fleet)
            found += [(fleet, host, folder) for host, folder in _list_tasks_of_hosts(hosts)]
        for host, folder in _list_tasks_of_hosts(base + "/hosts"):
            found.append((state_dir.read_owner(folder), host, folder))
    return found


def _list_tasks_of_hosts(hosts: str) -> "list[tuple[str, str]]":
    return [
        (host, "%s/%s/tasks/%s" % (hosts, host, task))
        for host in _list_names(hosts)
        for task in _list_names("%s/%s/tasks" % (hosts, host))
    ]


def _list_names(folder: str) -> "list[str]":
    """List the names in a directory of this user; none where it is missing or a link."""
    try:
        # Without the slash at its end, which would follow a link.
        if not os.access(folder, os.F_OK) or not is_own_dir(os.lstat(folder)):
            return []
    except OSError:
        return []
    return [name for name in os.listdir(folder) if protocol.is_name(name)]
