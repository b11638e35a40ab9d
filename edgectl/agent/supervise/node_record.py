# SPDX-License-Identifier: Apache-2.0
"""Record of the ROS nodes of a task.

Of ROS 1: ``master``, ``nodes`` (name -> address), ``ports`` on which its processes listen, after so many
``looks`` with these, and ``places``, all ports that they had. Of ROS 2: ``helper`` and ``nodes``.
"""

import os

from ..link import fast_json
from ..link.fast_json import Document
from . import records

_RECORD = "nodes"
_MAX_BYTES = 1 << 16


def read_nodes(folder: str) -> Document:
    """Read the record of the nodes of a task; empty where it has none."""
    try:
        fd = records.open_private_file(os.path.join(folder, _RECORD), os.O_RDONLY)
    except OSError:
        return {}
    with open(fd, "rb") as file:
        data = file.read(_MAX_BYTES)
    try:
        found = fast_json.loads(data.decode("ascii"))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def list_registered(folder: str) -> "dict[str, str]":
    """List the nodes of a task that were registered at a ROS 1 master: name -> address."""
    found = read_nodes(folder)
    return dict(found.get("nodes") or {}) if found.get("master") else {}


def write_nodes(folder: str, document: Document) -> None:
    """Replace the record, where the disk lets it: a task runs without it."""
    path = os.path.join(folder, _RECORD)
    try:
        fd = records.open_private_file(path + ".new", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        with open(fd, "wb") as file:
            file.write(fast_json.dumps(document).encode("ascii"))
        os.rename(path + ".new", path)
    except OSError:
        pass
