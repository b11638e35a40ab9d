# SPDX-License-Identifier: Apache-2.0
"""Name of a fleet whose inventory file states none."""

import hashlib
import os
import re
import socket
from pathlib import Path

_MACHINE_ID = Path("/etc/machine-id")
_MAX_STEM_LENGTH = 40
_HASH_LENGTH = 8


def derive_fleet_name(path: Path) -> str:
    """The stem of the file and a hash of this machine, this user and the real path of the file.

    The same file keeps its name, and two files, users or managers never share one.
    """
    identity = b"\0".join((_read_machine_id(), b"%d" % os.getuid(), os.fsencode(path.resolve())))
    return f"{_to_name(path.resolve().stem)}-{hashlib.sha256(identity).hexdigest()[:_HASH_LENGTH]}"


def _to_name(text: str) -> str:
    """``text`` in the alphabet of names."""
    kept = re.sub(r"[^a-z0-9._-]+", "-", text.lower()).strip("._-")
    return kept[:_MAX_STEM_LENGTH].rstrip("._-") or "fleet"


def _read_machine_id() -> bytes:
    """The id of this machine; its host name where it has none, as in some containers."""
    try:
        known = _MACHINE_ID.read_bytes().strip()
    except OSError:
        known = b""
    return known or socket.gethostname().encode()
