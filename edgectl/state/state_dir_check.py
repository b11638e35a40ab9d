# SPDX-License-Identifier: Apache-2.0
"""Facts about the fleet's state directory and its file system."""

import os
from pathlib import Path

from edgectl.errors import StateError
from edgectl.model.diagnosis import NOT_A_DIRECTORY, Disk
from edgectl.state.fleet_dir import ensure_fleet_dir
from edgectl.state.paths import get_fleet_path


def inspect_state_dir(fleet: str, inventory: Path) -> Disk:
    """Inspect the state directory of ``fleet``, which the file ``inventory`` describes; it is created if
    missing, as by every command.
    """
    obstacle, path = "", get_fleet_path(fleet)
    try:
        ensure_fleet_dir(fleet, inventory)
    except StateError as error:
        cause = error.__cause__
        obstacle = (cause.strerror or str(cause)) if isinstance(cause, OSError) else "is not private to you"
    there = _find_nearest_existing(path)
    if obstacle and not there.is_dir():
        obstacle, path = NOT_A_DIRECTORY, there
    found = os.statvfs(there)
    return Disk(
        path=str(path),
        free_bytes=found.f_bavail * found.f_frsize,
        total_bytes=found.f_blocks * found.f_frsize,
        files_left=found.f_favail if found.f_files else None,
        obstacle=obstacle,
    )


def _find_nearest_existing(path: Path) -> Path:
    """``path``, or its nearest existing parent."""
    return next(each for each in (path.absolute(), *path.absolute().parents) if each.exists())
