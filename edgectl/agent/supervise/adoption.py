# SPDX-License-Identifier: Apache-2.0
"""Adoption of tasks that the first release, which knew no fleets, left on this host, and of former names of
this host.

The fleet whose manager names a task of this host becomes its owner, once and for good; until then the task
has no owner and is not touched. Its directory stays where it is: the task's cookie and its supervisor name
it.

A host that was renamed keeps its tasks in the directory of its former name, for the same reason. The manager
sends the names that its inventory no longer has (ADR 0058).
"""

import os

from ..link.boot import check_private_dir, make_private_dir
from ..link.errors import RefusalError
from ..link.fast_json import Document
from . import records, state_dir, task_dirs
from .unowned import list_unowned_dirs


def adopt_tasks(request: Document) -> Document:
    """Operation ``adopt``: make this fleet the owner of those of ``tasks`` that have none; replies which.

    ``former``: the former names of this host, in place of those it knew; null leaves them as they are.
    """
    host, names = state_dir.check_name(request["host"]), set(request["tasks"])
    if request.get("former") is not None:
        _record_former_names(host, [state_dir.check_name(name) for name in request["former"]])
    adopted = []
    for folder in list_unowned_dirs(host):
        if os.path.basename(folder) in names:
            check_private_dir(folder)
            _leave_mark(host)
            if _take_ownership(folder):
                adopted.append(os.path.basename(folder))
    return {"adopted": sorted(adopted)}


def _record_former_names(host: str, names: "list[str]") -> None:
    """Record the names in the first base that can be written; no other keeps an older list."""
    written = False
    for levels in state_dir.list_host_dirs(host):
        path = os.path.join(levels[-1], state_dir.FORMER_NAMES_FILE_NAME)
        try:
            if not written:
                for level in levels:
                    make_private_dir(level)
                task_dirs.reserve_file(path, records.RECORD_BYTES)
                records.write_record(path, {"names": names}, durable=True)
                written = True
            elif os.path.lexists(path):
                os.unlink(path)
        except OSError:
            continue
    if not written:
        raise RefusalError(
            "no-state-dir", "no place to keep the former names of the host", "free some disk space there"
        )


def _leave_mark(host: str) -> None:
    """Mark the fleet's directory of ``host``, so that other requests look for adopted tasks at all."""
    for levels in state_dir.list_host_dirs(host):
        try:
            for level in levels:
                make_private_dir(level)
            task_dirs.reserve_file(os.path.join(levels[-1], state_dir.ADOPTION_FILE_NAME), 0)
        except OSError:
            continue
        return


def _take_ownership(folder: str) -> bool:
    """Write the owner, whole and once: of two fleets that adopt at the same time one succeeds."""
    final = os.path.join(folder, state_dir.OWNER_FILE_NAME)
    partial = "%s.%d" % (final, os.getpid())
    records.write_record(partial, {"fleet": state_dir.get_fleet()}, durable=True)
    try:
        os.link(partial, final)
    except OSError:
        return False
    finally:
        os.unlink(partial)
    return True
