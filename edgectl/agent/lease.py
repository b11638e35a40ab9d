"""When a manager was last heard of by this host: a stamp that every request renews, on a clock that no time server moves.

It counts seconds since boot, time asleep included. Where the usual place has become read-only, shared memory takes it: a full or
broken disk must not end the tasks that are looked after.
"""

import os

from . import proc, record, state
from .boot import check_private, private_dir

_NAME = "contact"


def renew(host: str) -> None:
    """Note that a manager calls. Nothing is made on a host that never ran a task."""
    places = state.host_places(host)
    if not any(os.path.isdir(levels[-1]) for levels in places):
        return None
    stamp = {"boot_id": proc.boot_id(), "at": round(proc.uptime(), 3)}
    for levels in places:
        try:
            for level in levels:
                private_dir(level)
            return record.write(os.path.join(levels[-1], _NAME), stamp)
        except OSError:
            continue
    return None


def last(host: str) -> float:
    """Seconds since boot at the newest request of this boot; 0 where none is known."""
    found = [0.0]
    for levels in state.host_places(host):
        try:
            for level in levels:
                check_private(level)
            stamp = record.read(os.path.join(levels[-1], _NAME))
        except OSError:
            continue
        if stamp.get("boot_id") == proc.boot_id():
            found.append(float(stamp.get("at", 0.0)))
    return max(found)
