# SPDX-License-Identifier: Apache-2.0
"""Equations (1)-(4) of the paper, each once, with nothing else in it."""

from collections.abc import Iterable, Sequence
from math import inf

from edgectl.model.assignment import UtilityTerms
from edgectl.model.policy import Weights

# Two utilities closer than this are equal; a term this little below 0 still fits.
EPSILON = 1e-9


def resource_utility(capacity: float, expected: float, demand: float) -> float:
    """Share of ``capacity`` left after placing ``demand``; eqs. (1)-(3), ADR 0002 and 0004.

    UT = (Delta - gamma - rho) / Delta, all in one unit (cores, bytes or bytes/s), capacity > 0. At most 1,
    falling as load or demand rises, negative where overcommitted; 1 where the host has no such limit
    (infinite capacity).
    """
    if capacity == inf:
        return 1.0
    return (capacity - expected - demand) / capacity


def total_utility(weights: Weights, terms: UtilityTerms) -> float | None:
    """Weighted sum of the terms, eq. (4); None where a term is missing.

    Between the least and the greatest term.
    """
    total = 0.0
    for weight, term in zip(weights.values(), terms.values()):  # noqa: B905  # both have the names of the table
        if term is None:
            return None
        total += weight * term
    return total


def compute_affinity(predecessors: Sequence[int], place: int) -> int:
    """a(h): +1 for each located predecessor at ``place``, -1 for each located elsewhere."""
    here = predecessors.count(place)
    return here - (len(predecessors) - here)


def task_utilities(rewards: Iterable[int], _predecessors: int = 0) -> dict[int, float]:
    """UT_task by reward: (m - r) / (m - 1) for rank r of the m distinct values, best first.

    0.5 where all are equal. In 0..1.
    """
    values = sorted(set(rewards), reverse=True)
    if len(values) == 1:
        return {values[0]: 0.5}
    return {value: (len(values) - 1 - position) / (len(values) - 1) for position, value in enumerate(values)}


def paper_task_utilities(rewards: Iterable[int], predecessors: int) -> dict[int, float]:
    """Task_Utility of Algorithm 1 to the letter: +1 where a predecessor runs, else -1, by reward."""
    return {value: 1.0 if value > -predecessors else -1.0 for value in rewards}
