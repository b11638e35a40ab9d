# SPDX-License-Identifier: Apache-2.0
"""Heartbeat of a host: the time of its last request, recorded by every request.

Measured in seconds since boot, suspended time included, so that no change of the wall clock matters. Where
the usual state directory cannot be written, shared memory takes the record: a full or broken disk must not
end tasks that a manager still contacts.
"""

from ..measure import system_files
from ..supervise import records, state_dir
from .boot import check_private_dir, is_dir, make_private_dir
from .fast_json import Document

_FILE_NAME = "contact"


def record_heartbeat(host: str) -> None:
    """Record a request of a manager to ``host``, under each of its names.

    Creates nothing on a host that never ran a task.
    """
    for name in state_dir.list_host_names(host):
        _record_under_name(name)


def _record_under_name(host: str) -> None:
    places = state_dir.list_host_dirs(host)
    if not any(is_dir(levels[-1]) for levels in places):
        return
    # Of the process table, which a host without tasks does not need, it has the clock.
    from ..measure import proc

    heartbeat: Document = {"boot_id": system_files.read_boot_id(), "at": round(proc.read_uptime_s(), 3)}
    for levels in places:
        try:
            for level in levels:
                make_private_dir(level)
            records.write_record(levels[-1] + "/" + _FILE_NAME, heartbeat)
        except OSError:
            continue
        break
    _record_for_adopted(host, heartbeat)


def _record_for_adopted(host: str, heartbeat: Document) -> None:
    """Record it, too, where the supervisors of adopted tasks look for it, while one of them lives."""
    adopted = state_dir.list_adopted_dirs(host)
    if not adopted:
        return
    from ..supervise import lockfile

    if not any(lockfile.is_lock_held(folder) for folder in adopted):
        return
    for base in state_dir.list_own_bases():
        try:
            records.write_record(state_dir.list_legacy_levels(base, host)[-2] + "/" + _FILE_NAME, heartbeat)
        except OSError:
            continue


def read_last_heartbeat(host: str) -> float:
    """Seconds since boot at the last request of this boot; 0 where none is known."""
    found = [0.0]
    for levels in state_dir.list_host_dirs(host):
        try:
            for level in levels:
                check_private_dir(level)
            heartbeat = records.read_record(levels[-1] + "/" + _FILE_NAME)
        except OSError:
            continue
        if heartbeat.get("boot_id") == system_files.read_boot_id():
            found.append(float(heartbeat.get("at", 0.0)))
    return max(found)
