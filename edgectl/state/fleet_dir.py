# SPDX-License-Identifier: Apache-2.0
"""Directory of a fleet: created, or taken over from the first release."""

from pathlib import Path

from edgectl.errors import StateError
from edgectl.state.lock import FleetLock
from edgectl.state.paths import ensure_private_dir, get_fleet_path, get_legacy_path

_WAIT_S = 5.0


def ensure_fleet_dir(fleet: str, inventory: Path) -> Path:
    """The state directory of ``fleet``, which the file ``inventory`` describes; created if it is missing.

    It belongs to the fleet, so the file may be renamed. What the first release kept under the path of the
    file is taken over.

    Raises:
        StateError: it belongs to another user, or others may write to it.
        LockBusyError: an edgectl of the first release is changing the fleet.
    """
    path, legacy = get_fleet_path(fleet), get_legacy_path(inventory)
    if not path.exists() and legacy.is_dir():
        _take_over(legacy, path)
    return ensure_private_dir(path)


def _take_over(legacy: Path, path: Path) -> None:
    """Rename the directory; of two calls at the same time one does it, and the other finds it done."""
    ensure_private_dir(legacy)
    try:
        with FleetLock(legacy, verb="rename of the state directory", timeout=_WAIT_S):
            legacy.rename(path)
    except (OSError, StateError) as error:
        if not path.is_dir():
            raise StateError(
                f"cannot rename {legacy} to {path}: {error}", hint="check that the state directory is yours"
            ) from error
