# SPDX-License-Identifier: Apache-2.0
"""Record of the role of an instance: whether its task is active here, or it waits as a standby.

``instance``, ``role``, ``generation`` of the last change, ``switching`` (a change is under way, or was left
half-way), ``pid`` and ``ticks`` of the process to which an activation was begun (0 for none), and ``done``:
that activation was proven. ``left``: pid, ticks and generation of the process that was last made inactive,
which still has the memory of its activity. The record says ``standby`` only while no process of the instance
can be active: it is written before an activation begins, and after a deactivation is proven (ADR 109).

A power cut ends the processes together with what they were, so it need not be durable.
"""

import os

from ..link import protocol
from ..link.fast_json import Document
from . import records

_RECORD = "role"


def begin_role(folder: str, spec: Document, instance: str, role: str, generation: int) -> None:
    """Record the role of an instance that is about to start; none of a task without an activation."""
    wanted = role if role == protocol.ROLE_STANDBY else protocol.ROLE_ACTIVE
    stated = {"instance": instance, "role": wanted, "generation": generation, "switching": False}
    write_role(folder, dict(stated, pid=0, ticks=-1, done=False) if spec.get("activation") else {})


def read_role(folder: str, instance: str) -> Document:
    """Read the record of this instance; empty where it has no role."""
    found = records.read_record(os.path.join(folder, _RECORD))
    return found if found.get("instance") == instance else {}


def write_role(folder: str, record: Document) -> None:
    """Replace the record. OSError where the file system refuses."""
    records.write_record(os.path.join(folder, _RECORD), record)


def is_begun(record: Document, pid: int, ticks: int) -> bool:
    """Whether an activation of this very process was begun: only then it can be active."""
    return bool(record.get("pid") == pid and record.get("ticks") == ticks)


def find_deactivated(record: Document, pid: int, ticks: int) -> int:
    """The generation with which this very process was made inactive; 0 if it is active, or never was."""
    left = record.get("left") or [0, -1, 0]
    return int(left[2]) if record.get("role") == protocol.ROLE_STANDBY and left[:2] == [pid, ticks] else 0


def is_proven_active(record: Document, pid: int, ticks: int) -> bool:
    """Whether this very process is active, and no change of that is under way."""
    stays = record.get("role") == protocol.ROLE_ACTIVE and not record.get("switching")
    return stays and bool(record.get("done")) and is_begun(record, pid, ticks)
