# SPDX-License-Identifier: Apache-2.0
"""Operation ``takeover``: a new supervisor for a task that lives although its supervisor was lost.

The lock of the task cannot change hands: its processes hold it, and the kernel gives it to nobody else while
they live. So a lock of its own, held for as long as the new supervisor lives, refuses a second takeover, and
the new supervisor takes the lock of the task as soon as it is free.
"""

import os

from ..link import heartbeat, protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from . import liveness, lockfile, logind, state_dir, status

_HINT = "edgectl probe, then plan again"


def take_over_task(request: Document) -> Document:
    """Start a supervisor that watches, restarts and fences the living tree of ``instance`` from now on.

    Where another one does so already, nothing is done.
    """
    from .launch import launch_takeover

    host, task = state_dir.check_name(request["host"]), state_dir.check_name(request["task"])
    logind.check_survives_logout()
    status.check_generation(host, task, int(request["generation"]))
    record, alive = status.find_current(host, task)
    if record is None or not alive or record.instance.get("instance") != request["instance"]:
        raise RefusalError(
            protocol.NOT_RUNNING, "instance %s of %s is not running" % (request["instance"], task), _HINT
        )
    guard = lockfile.take_lock(record.folder, lockfile.GUARD)
    if guard < 0 or liveness.find_supervisor(liveness.read_instance(record.folder)):
        _close_lock(guard)
        return {"state": protocol.ALREADY_RUNNING, "instance": request["instance"]}
    if not liveness.is_adoptable(record):
        _close_lock(guard)
        raise RefusalError(
            "not-adoptable",
            "%s runs in a systemd scope, which takes no new supervisor" % task,
            "edgectl restart " + task,
        )
    heartbeat.record_heartbeat(host)
    spec = request["spec"]
    if spec.get("ros"):
        from ..ros.local import fill_request
        from ..ros.question import start_helpers

        spec = fill_request(spec)
        start_helpers(spec, host)
    if spec.get("image"):
        from ..containers.ending import end_followers

        end_followers(record.folder)
    lock = lockfile.take_lock(record.folder)
    try:
        report = launch_takeover(record, lock, guard, spec)
    finally:
        _close_lock(lock)
        _close_lock(guard)
    if "error" in report:
        raise RefusalError("start-failed", report["error"], "edgectl restart " + task)
    return {"state": protocol.TAKEN_OVER, "instance": request["instance"]}


def _close_lock(fd: int) -> None:
    if fd >= 0:
        os.close(fd)
