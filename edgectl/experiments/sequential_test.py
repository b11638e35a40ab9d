# SPDX-License-Identifier: Apache-2.0
"""Sequential test for the fastest of several schemes: exact, and valid whenever one looks (ADR 135).

Runs are paired by their seed. For each pair of schemes the number of seeds with which one of them is the
faster is compared with a fair coin. The evidence is the likelihood under an even mixture of all coins that
favour it, over that of the fair coin: a supermartingale if it is not favoured, so the probability that it
ever reaches 1/error is at most the error (Ville 1939). No distribution of the mission times is assumed.
"""

from collections.abc import Mapping, Sequence
from math import comb


def compute_evidence(wins: int, losses: int) -> float:
    """Evidence that one scheme is the faster in more than half of the seeds; 1 without seeds.

    The integral of 2 (2 p)^wins (2 (1 - p))^losses over p from 1/2 to 1, in closed form.
    """
    total = wins + losses
    return sum(comb(total + 1, count) for count in range(wins + 1)) / ((total + 1) * comb(total, wins))


def find_certain_winner(times: Mapping[str, Sequence[float]], error: float) -> str | None:
    """The scheme that is faster than each other one in more than half of the seeds, or None while that may be
    wrong with a probability above ``error``.

    ``times``: mission times by scheme, paired. Another scheme than the best one has to be wrong against the
    best one, so its evidence there has to reach (number of others) / error. Equal times count for nobody.
    """
    needed = (len(times) - 1) / error
    for name, own in times.items():
        others = (other for rival, other in times.items() if rival != name)
        if all(_compare(own, other) >= needed for other in others):
            return name
    return None


def _compare(own: Sequence[float], other: Sequence[float]) -> float:
    wins = sum(one < two for one, two in zip(own, other, strict=True))
    losses = sum(one > two for one, two in zip(own, other, strict=True))
    return compute_evidence(wins, losses)
