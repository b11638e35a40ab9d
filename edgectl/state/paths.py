# SPDX-License-Identifier: Apache-2.0
"""Paths of the manager's state: one private directory per fleet, created private; links are not followed."""

import hashlib
import os
import stat
from pathlib import Path

import platformdirs

from edgectl.errors import StateError

_DIR_MODE = 0o700
FILE_MODE = 0o600


def get_state_root() -> Path:
    """``$EDGECTL_STATE_DIR``, else the user's state directory for edgectl."""
    named = os.environ.get("EDGECTL_STATE_DIR")
    return Path(named) if named else Path(platformdirs.user_state_dir("edgectl", appauthor=False))


def get_fleet_path(fleet: str) -> Path:
    """The directory of a fleet, whether it exists or not."""
    return get_state_root() / "fleets" / fleet


def get_legacy_path(inventory: Path) -> Path:
    """The directory in which the first release kept the state of a fleet: named by the path of its file."""
    resolved = inventory.resolve()
    name = f"{resolved.stem}-{hashlib.sha256(os.fsencode(resolved)).hexdigest()[:8]}"
    return get_state_root() / "fleets" / name


def ensure_private_dir(path: Path) -> Path:
    """Create ``path`` (mode 0700 from the start) and its parents, and check that only this user can access
    it.
    """
    try:
        for parent in reversed([path, *path.parents]):
            if not parent.exists():
                parent.mkdir(mode=_DIR_MODE, exist_ok=True)
        status = path.lstat()
    except OSError as error:
        raise StateError(
            f"cannot use state directory {path}: {error.strerror}",
            hint="set EDGECTL_STATE_DIR to a directory you own",
        ) from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise StateError(
            f"state directory {path} is not private to you", hint=f"chown it to yourself and chmod 700 {path}"
        )
    _check_parents(path)
    return path


def _check_parents(path: Path) -> None:
    """Refuse a directory below one in which another user may rename it: cordons, fences and locks would be
    theirs to exchange.

    A sticky directory, as /tmp is, lets only the owner rename; a group may write if it is the caller's own.
    """
    for parent in {*path.absolute().parents, *path.resolve().parents}:
        for status in (parent.lstat(), parent.stat()):
            shared = status.st_mode & stat.S_IWOTH or (
                status.st_mode & stat.S_IWGRP and status.st_gid != os.getegid()
            )
            exposed = shared and not status.st_mode & stat.S_ISVTX and not stat.S_ISLNK(status.st_mode)
            if exposed or status.st_uid not in _list_trusted_users():
                raise StateError(
                    f"state directory {path} is below {parent}, which another user may change",
                    hint=f"chown it to yourself and chmod go-w {parent}, or set EDGECTL_STATE_DIR",
                )


def _list_trusted_users() -> set[int]:
    """Root, the caller, and whoever became root by sudo."""
    sudo = os.environ.get("SUDO_UID", "") if os.geteuid() == 0 else ""
    return {0, os.geteuid(), *([int(sudo)] if sudo.isdecimal() else [])}


def open_private_file(path: Path, flags: int) -> int:
    """Open a file that only this user may access; links are not followed and children do not inherit it."""
    try:
        return os.open(path, flags | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, FILE_MODE)
    except OSError as error:
        raise StateError(
            f"cannot open {path}: {error.strerror}",
            hint="check that the state directory is yours and the disk is not full",
        ) from error


def sync_dir(path: Path) -> None:
    """Make a rename in directory ``path`` durable."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
