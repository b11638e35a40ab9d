"""System reward assignment (Section IV-B1 of the paper; DESIGN 5.6): tasks like to be where their predecessors are."""

from collections.abc import Iterable, Sequence


def reward(predecessors: Sequence[int], place: int) -> int:
    """a(h): +1 for each located predecessor at ``place``, -1 for each located elsewhere."""
    here = predecessors.count(place)
    return here - (len(predecessors) - here)


def task_utilities(rewards: Iterable[int]) -> dict[int, float]:
    """UT_task by reward: (m - r) / (m - 1) for rank r of the m distinct values, best first; 0.5 where all are equal. In 0..1."""
    values = sorted(set(rewards), reverse=True)
    if len(values) == 1:
        return {values[0]: 0.5}
    return {value: (len(values) - 1 - position) / (len(values) - 1) for position, value in enumerate(values)}


def signs(rewards: Iterable[int], predecessors: int) -> dict[int, float]:
    """Task_Utility of Algorithm 1 to the letter: +1 where a predecessor runs, else -1, by reward."""
    return {value: 1.0 if value > -predecessors else -1.0 for value in rewards}
