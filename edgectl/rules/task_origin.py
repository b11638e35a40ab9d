# SPDX-License-Identifier: Apache-2.0
"""Running tasks that no given file lists: those that a run stops, and the others (ADR 0039)."""

from collections.abc import Iterable

from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.snapshot import TaskSample
from edgectl.model.task import Tasks


def find_task_file(name: str, samples: Iterable[TaskSample], manager: ManagerState) -> str:
    """The task file of a running task: the one that last listed it, else the one that its newest instance was
    started from; "" where neither is known.
    """
    placement = manager.placements.get(name)
    if placement is not None and placement.file:
        return placement.file
    newest = max(samples, key=lambda sample: sample.generation, default=None)
    return newest.file if newest is not None else ""


def is_left_alone(
    name: str, samples: Iterable[TaskSample], tasks: Tasks, manager: ManagerState, policy: Policy
) -> bool:
    """Whether the running task, which no given file lists, runs on: its own file was not given, and nothing
    is pruned.
    """
    return not policy.prune and not tasks.is_given(find_task_file(name, samples, manager))
