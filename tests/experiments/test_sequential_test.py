# SPDX-License-Identifier: Apache-2.0
"""The sequential test for the fastest scheme: its stated error holds, by simulation and exactly."""

import random
from fractions import Fraction
from math import comb

import pytest

from edgectl.experiments.sequential_test import compute_evidence, find_certain_winner

ERROR = 0.05


def test_evidence_is_the_integral_that_it_says() -> None:
    for wins, losses in [(0, 0), (1, 0), (0, 1), (5, 2), (9, 0), (12, 7)]:
        total = wins + losses
        steps = 20_000
        points = [0.5 + 0.5 * (step + 0.5) / steps for step in range(steps)]
        mean = sum((2 * p) ** wins * (2 * (1 - p)) ** losses for p in points) / steps
        assert compute_evidence(wins, losses) == pytest.approx(mean, rel=1e-6), total


def test_evidence_of_a_fair_coin_is_expected_to_stay_one() -> None:
    # Exact: the next evidence, averaged over a fair coin, is the present one (a martingale).
    for wins in range(8):
        for losses in range(8):
            now = _exact(wins, losses)
            assert (_exact(wins + 1, losses) + _exact(wins, losses + 1)) / 2 == now
            assert compute_evidence(wins, losses) == pytest.approx(float(now))


def _exact(wins: int, losses: int) -> Fraction:
    total = wins + losses
    return Fraction(sum(comb(total + 1, k) for k in range(wins + 1)), (total + 1) * comb(total, wins))


def count_false_winners(schemes: int, draws: int, seed: int) -> int:
    """How often a winner is named among schemes with the same distribution, looked at after every seed."""
    dice, named = random.Random(seed), 0
    for _ in range(draws):
        times: dict[str, list[float]] = {f"scheme{number}": [] for number in reversed(range(schemes))}
        for _seed in range(30):
            shared = dice.gauss(0.0, 1.0)  # paired: what a seed has in common
            for each in times.values():
                each.append(shared + dice.gauss(0.0, 1.0))
            if find_certain_winner(times, ERROR) is not None:
                named += 1
                break
    return named


@pytest.mark.parametrize("schemes", [2, 3])
def test_no_more_winners_than_stated_where_there_is_none(schemes: int) -> None:
    # Every winner is wrong here. 600 draws: by chance more than 48 of 30 expected at most only once in 1,000.
    assert count_false_winners(schemes, 600, 1) <= 48


def test_a_scheme_that_is_always_faster_is_found_after_eight_seeds_of_three_schemes() -> None:
    times = {"fast": [1.0] * 8, "slow": [2.0] * 8, "other": [3.0] * 8}
    assert find_certain_winner(times, ERROR) == "fast"
    fewer = {name: each[:7] for name, each in times.items()}
    assert find_certain_winner(fewer, ERROR) is None


def test_equal_times_count_for_nobody() -> None:
    assert find_certain_winner({"one": [1.0] * 100, "two": [1.0] * 100}, ERROR) is None
