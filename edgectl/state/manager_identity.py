# SPDX-License-Identifier: Apache-2.0
"""The name by which hosts know this manager: one per state directory and machine."""

import contextlib
import hashlib
import os
import secrets
import socket
from pathlib import Path

from edgectl.state.paths import open_private_file

_FILE_NAME, _TOKEN_BYTES = "manager-id", 32
_MACHINE_ID = Path("/etc/machine-id")


def load_manager_id(fleet_dir: Path) -> str:
    """The name of this manager, made at the first call. Call it under the fleet's lock.

    A state directory that two machines share, or that was copied with its machine's disk, names two managers.

    Raises:
        StateError: the file cannot be opened.
    """
    descriptor = open_private_file(fleet_dir / _FILE_NAME, os.O_RDWR)
    try:
        token = os.pread(descriptor, _TOKEN_BYTES, 0)
        if len(token) < _TOKEN_BYTES:
            token = secrets.token_hex(_TOKEN_BYTES // 2).encode()
            with contextlib.suppress(OSError):  # a full disk: the name lasts for this run
                os.pwrite(descriptor, token, 0)
                os.fsync(descriptor)
    finally:
        os.close(descriptor)
    return _compute_name(token)


def find_manager_id(fleet_dir: Path) -> str:
    """The name of this manager; "" where it has none yet, or none that can be read."""
    try:
        token = (fleet_dir / _FILE_NAME).read_bytes()[:_TOKEN_BYTES]
    except OSError:
        return ""
    return _compute_name(token) if len(token) == _TOKEN_BYTES else ""


def _compute_name(token: bytes) -> str:
    return hashlib.sha256(token + _read_machine_id()).hexdigest()[:32]


def copy_manager_id(fleet_dir: Path, target: Path) -> None:
    """Give the state directory ``target`` the name of the manager of ``fleet_dir``: what one of them claimed,
    the other may claim at once.

    Raises:
        StateError: a file cannot be opened.
    """
    load_manager_id(fleet_dir)
    source, copy = (open_private_file(directory / _FILE_NAME, os.O_RDWR) for directory in (fleet_dir, target))
    try:
        with contextlib.suppress(OSError):  # a full disk: it has a name of its own
            os.pwrite(copy, os.pread(source, _TOKEN_BYTES, 0), 0)
    finally:
        os.close(source)
        os.close(copy)


def _read_machine_id() -> bytes:
    try:
        return _MACHINE_ID.read_bytes().strip() or socket.gethostname().encode()
    except OSError:
        return socket.gethostname().encode()
