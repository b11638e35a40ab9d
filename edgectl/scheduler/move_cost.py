# SPDX-License-Identifier: Apache-2.0
"""Measured cost of a move (ADR 0018): the gain over the expected stay against the downtime and its price."""

from collections.abc import Mapping, Sequence
from math import fsum

from edgectl.dataclass import dataclass
from edgectl.model.assignment import MoveCost
from edgectl.model.manager_state import ManagerState
from edgectl.model.task import Task
from edgectl.rules.median import compute_median

# So many downtimes of one task on one host make a figure.
MIN_DOWNTIME_SAMPLES = 5
# Bounds of an expected stay in seconds: no move is planned to be undone at once, and the load is not known
# further ahead.
STAY_FLOOR_S, STAY_CAP_S = 120.0, 600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HandoffHistory:
    """History of moves.

    ``downtimes``: median in seconds by task and host, where there are enough; ``stays`` by task.
    """

    downtimes: Mapping[str, Mapping[str, float]]
    stays: Mapping[str, Sequence[float]]


def collect_handoff_history(manager: ManagerState) -> HandoffHistory:
    """The measured moves of ``manager``."""
    downtimes: dict[str, dict[str, float]] = {}
    for (task, host), seconds in manager.downtimes.items():
        if len(seconds) >= MIN_DOWNTIME_SAMPLES:
            downtimes.setdefault(task, {})[host] = compute_median(seconds)
    return HandoffHistory(downtimes=downtimes, stays=manager.stays)


def estimate_move_cost(
    handoffs: HandoffHistory, task: Task, host: str, here_s: float | None
) -> MoveCost | None:
    """Expected cost of moving ``task`` to ``host``; None where too little is measured.

    A host without enough measurements is taken to be as slow as the slowest that has them. ``here_s``:
    seconds that the task has been where it is, None where it is not there yet.
    """
    known = handoffs.downtimes.get(task.name)
    if known is None:
        return None
    downtime = known.get(host, max(known.values()))
    return MoveCost(
        stay_s=estimate_stay(handoffs.stays.get(task.name, ()), here_s),
        downtime_s=downtime,
        per_s=task.downtime_cost,
    )


def estimate_stay(stays: Sequence[float], here_s: float | None) -> float:
    """Seconds that a task is likely to stay after a move: the mean of its past stays, else as long as it has
    been where it is.
    """
    guess = fsum(stays) / len(stays) if stays else here_s or 0.0
    return min(max(guess, STAY_FLOOR_S), STAY_CAP_S)
