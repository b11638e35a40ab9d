# SPDX-License-Identifier: Apache-2.0
"""The secret with which the hosts of a fleet seal the compiled agent (ADR 57): one per fleet directory."""

import contextlib
import fcntl
import os
import secrets
from pathlib import Path

from edgectl.state.paths import open_private_file

_FILE_NAME, _KEY_LENGTH = "agent-key", 32


def load_cache_key(fleet_dir: Path) -> str:
    """32 hexadecimal digits, made at the first call. On a full disk they last for this run.

    Raises:
        StateError: the file cannot be opened.
    """
    descriptor = open_private_file(fleet_dir / _FILE_NAME, os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        found = os.pread(descriptor, _KEY_LENGTH, 0).decode("ascii", "replace")
        if len(found) == _KEY_LENGTH and found.isalnum():
            return found
        key = secrets.token_hex(_KEY_LENGTH // 2)
        with contextlib.suppress(OSError):
            os.pwrite(descriptor, key.encode(), 0)
        return key
    finally:
        os.close(descriptor)
