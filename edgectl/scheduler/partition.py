# SPDX-License-Identifier: Apache-2.0
"""Replacement of tasks on unreachable hosts (ADR 0020): never while the copy there may still run."""

from edgectl.model.manager_state import ManagerState
from edgectl.model.task import Task, UnreachablePolicy

# Added to the longest time that a copy on a silent host can live on: clocks of two machines never run quite
# alike.
FENCE_SLACK_S = 10.0
# Time of the preset on the host before KILL (20 s of INT, 5 s of TERM), whatever grace is stated beside it.
_ROS_PRESET_S = 25.0


def seconds_until_replaced(task: Task, host: str, manager: ManagerState, now: float) -> float | None:
    """Seconds for which ``task`` of the unreachable ``host`` is still held: 0 = it may be replaced now, None
    = until ``host`` answers or is fenced.

    A fence of the operator counts for every task; the passing of time only where the task's supervisor stops
    it by then: not for one whose supervisor was lost (ADR 0041).
    """
    if host in manager.fenced:
        return 0.0
    contact = manager.contact.get(host)
    if (
        task.on_unreachable is not UnreachablePolicy.REPLACE
        or task.self_fence is None
        or contact is None
        or task.name in manager.orphans.get(host, ())
        or _has_spec_changed(task, manager)
    ):
        return None
    gone = max(task.replace_after, task.self_fence + _get_seconds_until_kill(task) + FENCE_SLACK_S)
    return max(0.0, contact + gone - now)


def _get_seconds_until_kill(task: Task) -> float:
    return max(task.stop.grace, _ROS_PRESET_S) if task.stop.preset == "ros" else task.stop.grace


def _has_spec_changed(task: Task, manager: ManagerState) -> bool:
    """True where the copy was started from another specification: it may fence itself later, or never."""
    placement = manager.placements.get(task.name)
    return placement is not None and placement.spec_hash not in ("", task.spec_hash)
