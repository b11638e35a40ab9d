# SPDX-License-Identifier: Apache-2.0
"""Tasks that the first release, which knew no fleets, left on this host, and that no fleet has adopted.

A module of its own: each probe lists them, and few requests adopt one.
"""

import os

from ..link import protocol
from ..link.boot import is_dir
from . import records, state_dir


def list_unowned_tasks(host: str) -> "list[str]":
    """List the tasks of ``host`` in the layout without fleets that no fleet has adopted."""
    return sorted({folder.rpartition("/")[2] for folder in list_unowned_dirs(host)})


def list_unowned_dirs(host: str) -> "list[str]":
    """List the directories of those tasks."""
    found = []
    for base in state_dir.list_own_bases():
        tasks = state_dir.list_legacy_levels(base, host)[-1]
        names = os.listdir(tasks) if is_dir(tasks) else []
        found += [tasks + "/" + name for name in names if protocol.is_name(name)]
    return [
        folder
        for folder in found
        if records.read_record(folder + "/instance") and not state_dir.read_owner(folder)
    ]
