# SPDX-License-Identifier: Apache-2.0
"""Task sequencing (Section IV-A of the paper, ADR 0001): predecessors first, then by key."""

import heapq
import math
from collections.abc import Callable, Collection, Iterable

from edgectl.model.policy import SequenceRule
from edgectl.model.task import Need, NeedCondition, Task
from edgectl.names import natural_key


def order_tasks(tasks: Iterable[Task], rule: SequenceRule) -> tuple[Task, ...]:
    """The tasks in the order in which they are placed: again and again the first by key whose ``needs`` are
    all sequenced.

    Needs that name no task of the file are ignored here (they are missing predecessors later).

    Raises:
        ValueError: the needs form a cycle.
    """
    by_name = {task.name: task for task in tasks}
    waiting = {
        name: {need.task for need in task.needs if need.task in by_name} for name, task in by_name.items()
    }
    successors: dict[str, list[str]] = {name: [] for name in by_name}
    for name, needs in waiting.items():
        for need in needs:
            successors[need].append(name)
    ranked = sorted(by_name.values(), key=_SORT_KEYS[rule])
    ranks = {task.name: rank for rank, task in enumerate(ranked)}
    eligible = [ranks[name] for name, needs in waiting.items() if not needs]
    heapq.heapify(eligible)
    ordered = []
    while eligible:
        task = ranked[heapq.heappop(eligible)]
        ordered.append(task)
        for successor in successors[task.name]:
            waiting[successor].discard(task.name)
            if not waiting[successor]:
                heapq.heappush(eligible, ranks[successor])
    if len(ordered) < len(by_name):
        stuck = sorted((name for name, needs in waiting.items() if needs), key=natural_key)
        raise ValueError(f"needs form a cycle among {', '.join(stuck)}")
    return tuple(ordered)


def is_need_met(need: Need, located: Collection[str], completed: Collection[str]) -> bool:
    """Placed in this plan or running is enough (the executor waits for ready), unless it must have completed
    (ADR 0013).
    """
    return need.task in completed or (need.until is not NeedCondition.COMPLETED and need.task in located)


def _connectivity_key(task: Task) -> tuple[float, tuple[tuple[str | int, ...], str]]:
    return -task.priority, natural_key(task.name)


def _sensitivity_key(task: Task) -> tuple[float, float, tuple[tuple[str | int, ...], str]]:
    deadline = math.inf if task.deadline is None else task.deadline
    return deadline, -task.priority, natural_key(task.name)


_SORT_KEYS: dict[SequenceRule, Callable[[Task], tuple[object, ...]]] = {
    SequenceRule.CONNECTIVITY: _connectivity_key,
    SequenceRule.SENSITIVITY: _sensitivity_key,
}
