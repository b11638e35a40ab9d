# SPDX-License-Identifier: Apache-2.0
"""Runs of predecessors: which of them a task was started with, as marks that a host keeps for it."""

import hashlib
from collections.abc import Mapping

from edgectl.model.task import Need, Task

_MARK_LENGTH = 6
# Stands for the mark of a predecessor that does not live: no run has it.
NO_RUN = "-"


def list_followed_needs(task: Task) -> tuple[Need, ...]:
    """The needs of ``task`` with which it restarts, in the order of its marks."""
    return tuple(need for need in task.needs if need.restart is not None)


def mark_run(instance: str, restarts: int) -> str:
    """The mark of one run of a task: another after each start and each restart by its supervisor."""
    return hashlib.sha256(f"{instance}:{restarts}".encode()).hexdigest()[:_MARK_LENGTH]


def join_marks(task: Task, marks: Mapping[str, str]) -> str:
    """The marks of the predecessors of ``task`` by their names; empty for one that is not known."""
    return ",".join(marks.get(need.task, "") for need in list_followed_needs(task))


def find_restarted_need(task: Task, recorded: str, marks: Mapping[str, str]) -> str | None:
    """The first predecessor whose run is another than when ``task`` was started, with these ``recorded``
    marks. Unknown ones, then or now, do not count.
    """
    needs, before = list_followed_needs(task), recorded.split(",")
    if len(before) != len(needs):
        return None
    for need, then in zip(needs, before, strict=True):
        now = marks.get(need.task)
        if then and now and now != then:
            return need.task
    return None
