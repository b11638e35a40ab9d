# SPDX-License-Identifier: Apache-2.0
"""Mark of an instance whose successor starts on another host while it still runs: a start-first move.

Two nodes of one ROS name do not bear each other: the master of ROS 1 shuts the first one down, and in ROS 2
both live under one name. What that does to the old instance is no fault of it.
"""

import os

from ..measure import proc
from . import records

_RECORD = "successor"


def write_leaving(folder: str, instance: str, seconds: float) -> None:
    """Write the mark: for so long a successor of the instance starts; 0: it does so no longer."""
    until = round(proc.read_uptime_s() + seconds, 2)
    records.write_record(os.path.join(folder, _RECORD), {"instance": instance, "until": until})


def is_leaving(folder: str, instance: str) -> bool:
    """Whether a successor of the instance starts elsewhere at the moment, as far as this host was told."""
    found = records.read_record(os.path.join(folder, _RECORD))
    return found.get("instance") == instance and proc.read_uptime_s() < float(found.get("until", 0.0))
