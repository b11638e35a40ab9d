# SPDX-License-Identifier: Apache-2.0
"""Equations (1)-(4) and UT_task, worked by hand."""

import pytest

from edgectl.model.assignment import UtilityTerms
from edgectl.model.policy import Weights
from edgectl.model.resource import TERMS
from edgectl.scheduler.utility import (
    compute_affinity,
    paper_task_utilities,
    resource_utility,
    task_utilities,
    total_utility,
)


@pytest.mark.parametrize(
    ("capacity", "expected", "demand", "utility"),
    [
        (100.0, 40.0, 25.0, 0.35),  # (100 - 40 - 25) / 100
        (4.0, 0.0, 0.0, 1.0),  # (4 - 0 - 0) / 4
        (4.0, 3.0, 1.0, 0.0),  # (4 - 3 - 1) / 4: just fits
        (4.0, 3.0, 3.0, -0.5),  # (4 - 3 - 3) / 4: overcommitted
    ],
)
def test_resource_utility(capacity: float, expected: float, demand: float, utility: float) -> None:
    assert resource_utility(capacity, expected, demand) == pytest.approx(utility)


def test_total_is_the_weighted_sum() -> None:
    weights = Weights(cpu=0.4, memory=0.2, network=0.3, task=0.1)
    # .4 x .5 + .2 x .25 + .3 x .8 + .1 x 1 = .2 + .05 + .24 + .1
    terms = dict.fromkeys(TERMS, 0.0) | {"cpu": 0.5, "memory": 0.25, "network": 0.8, "task": 1.0}
    assert total_utility(weights, UtilityTerms(terms)) == pytest.approx(0.59)
    assert total_utility(weights, UtilityTerms(terms | {"memory": None})) is None


@pytest.mark.parametrize(
    ("predecessors", "place", "expected"),
    [((), 0, 0), ((0,), 0, 1), ((0,), 1, -1), ((0, 0, 1), 0, 1), ((0, 0, 1), 1, -1), ((0, 0, 1), 2, -3)],
)
def test_reward(predecessors: tuple[int, ...], place: int, expected: int) -> None:
    assert compute_affinity(predecessors, place) == expected


@pytest.mark.parametrize(
    ("rewards", "expected"),
    [
        ([0, 0, 0], {0: 0.5}),  # m = 1
        ([1, -1, -1], {1: 1.0, -1: 0.0}),  # m = 2: (2-1)/1, (2-2)/1; equal rewards share a rank
        ([1, -1, -3], {1: 1.0, -1: 0.5, -3: 0.0}),  # m = 3: 2/2, 1/2, 0/2
        ([3, 1, -1, -3], {3: 1.0, 1: 2 / 3, -1: 1 / 3, -3: 0.0}),
    ],
)
def test_task_utility_is_the_rank_over_distinct_rewards(
    rewards: list[int], expected: dict[int, float]
) -> None:
    assert task_utilities(rewards) == pytest.approx(expected)


def test_algorithm_1_gives_signs() -> None:
    assert paper_task_utilities({1, -1, -3}, 3) == {1: 1.0, -1: 1.0, -3: -1.0}
    assert paper_task_utilities({0}, 0) == {0: -1.0}
