# SPDX-License-Identifier: Apache-2.0
"""Groups (ADR 73): tasks that are started all together, or not at all."""

from collections.abc import Collection, Mapping, Sequence

from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.task import Task
from edgectl.names import natural_key

# Groups that are given up one after the other; then all that are incomplete at once.
MAX_ROUNDS = 16


def withhold_incomplete_groups(
    groups: Mapping[str, Sequence[str]],
    tasks: Mapping[str, Task],
    decisions: Sequence[Decision],
    running: Collection[str],
    *,
    every: bool = False,
) -> dict[str, Decision]:
    """Decisions that leave a group unplaced of which some task has no place, and others would be started.

    Of several groups that of the lowest priority, for its room may complete another; ``every``: all of them.
    What runs is not concerned. Empty where nothing is left to withhold.
    """
    by_task = {decision.task: decision for decision in decisions}
    incomplete = [
        group
        for group, members in groups.items()
        if any(_is_missing(by_task[name]) for name in members)
        and any(_is_new(by_task[name], running) for name in members)
    ]
    incomplete.sort(key=natural_key, reverse=True)
    incomplete.sort(key=lambda group: max(tasks[name].priority for name in groups[group]))
    found: dict[str, Decision] = {}
    for group in incomplete if every else incomplete[:1]:
        found |= _withhold(groups[group], by_task, running)
    return found


def _is_missing(decision: Decision) -> bool:
    """Whether the task has no place, for another reason than that it waits for one that runs."""
    return decision.verdict is Verdict.UNPLACED and decision.reason is not Reason.PREDECESSOR_INCOMPLETE


def _is_new(decision: Decision, running: Collection[str]) -> bool:
    return decision.verdict is Verdict.PLACED and decision.task not in running


def _withhold(
    members: Sequence[str], by_task: Mapping[str, Decision], running: Collection[str]
) -> dict[str, Decision]:
    """Members without a place keep their reason; those that would be started name the first of them."""
    missing = [name for name in members if _is_missing(by_task[name])]
    started = [name for name in members if _is_new(by_task[name], running)]
    withheld = {
        name: Decision(task=name, verdict=Verdict.UNPLACED, reason=Reason.GROUP, subject=missing[0])
        for name in started
    }
    return withheld | {name: by_task[name] for name in missing if name not in running}
