"""Time at which a watch looks again: the copy of a task on a silent host has stopped itself by then."""

from enum import IntEnum

from edgectl.model.manager_state import ManagerState
from edgectl.model.task import Tasks, UnreachablePolicy
from edgectl.scheduler.partition import seconds_until_replaced

# A host that is silent is asked once more, for at most a probe, before its tasks are replaced.
_MARGIN_S = 1.0
# A decision is made just after the moment, not just before it.
_ROUNDING_S = 0.01


class FailoverStage(IntEnum):
    """How near the replacement of the tasks of a host is: its last contact is fresh, it ought to be asked
    now, or its tasks may be replaced.
    """

    FRESH = 0
    SUSPECTED = 1
    DUE = 2


def has_replaced_tasks(tasks: Tasks) -> bool:
    """Whether any task is replaced as time passes."""
    return any(
        task.on_unreachable is UnreachablePolicy.REPLACE and task.self_fence is not None
        for task in tasks.tasks.values()
    )


def list_failover_times(tasks: Tasks, manager: ManagerState, now: float) -> dict[str, float]:
    """Seconds until the first task of each host may be replaced unless the host is heard of again.

    0: it may be now. Only hosts with a task that is replaced as time passes (docs/adr/0020).
    """
    found: dict[str, float] = {}
    for name, placement in manager.placements.items():
        task = tasks.tasks.get(name)
        if task is None or placement.host in manager.fenced:
            continue
        left = seconds_until_replaced(task, placement.host, manager, now)
        if left is not None:
            found[placement.host] = min(left, found.get(placement.host, left))
    return found


def compute_stage(left_s: float, probe_s: float) -> FailoverStage:
    """The stage of a host ``left_s`` before its tasks may be replaced; ``probe_s``: deadline of a probe."""
    if left_s <= 0.0:
        return FailoverStage.DUE
    return FailoverStage.SUSPECTED if left_s <= probe_s + _MARGIN_S else FailoverStage.FRESH


def compute_stages(times: dict[str, float], probe_s: float) -> dict[str, FailoverStage]:
    """The stage of each host."""
    return {host: compute_stage(left_s, probe_s) for host, left_s in times.items()}


def has_advanced(before: dict[str, FailoverStage], now: dict[str, FailoverStage]) -> bool:
    """Whether any host is nearer to the replacement of its tasks than when it was last looked at."""
    return any(stage > before.get(host, FailoverStage.FRESH) for host, stage in now.items())


def find_next_stage_s(times: dict[str, float], probe_s: float) -> float | None:
    """Seconds until the next host reaches its next stage; None: none will."""
    waits = [
        (left_s if left_s <= probe_s + _MARGIN_S else left_s - probe_s - _MARGIN_S) + _ROUNDING_S
        for left_s in times.values()
        if left_s > 0.0
    ]
    return min(waits, default=None)


def list_rested_hosts(
    times: dict[str, float], before: dict[str, FailoverStage], probe_s: float
) -> dict[str, float]:
    """The hosts that are not asked again, if they were asked in vain, and for how long (s): a probe that
    waits for them would delay the replacement.
    """
    return {
        host: left_s + _MARGIN_S
        for host, left_s in times.items()
        if before.get(host, FailoverStage.FRESH) < FailoverStage.DUE
        and compute_stage(left_s, probe_s) is not FailoverStage.FRESH
    }
