# SPDX-License-Identifier: Apache-2.0
"""Summary of a short probe of a link: the rate, and whether the link was the limit."""

import pytest

from edgectl.agent.measure.link_sample import Moment, summarize_moments

RATE = 12.5e6


def send(shares: list[float], *, held: bool = True) -> list[Moment]:
    """Moments every 5 ms, between which so much of RATE was confirmed."""
    seen = [Moment(0, 0.0, held)]
    for share in shares:
        seen.append(Moment(seen[-1].count + int(share * RATE * 0.005), seen[-1].seconds + 0.005, held))
    return seen


@pytest.mark.parametrize(
    ("shares", "held", "full"),
    [
        ([0.5] * 18, True, True),
        ([0.1] * 6 + [0.5] * 12, True, True),
        ([0.98] * 18, True, False),  # what was asked for: it may carry more
        ([0.5] * 18, False, False),  # the sender had nothing to send, or TCP was still beginning
        ([0.02, 0.02, 0.04, 0.04] * 2 + [0.08, 0.08, 0.16, 0.16, 0.32, 0.32, 0.5, 0.5], True, False),
    ],
)
def test_a_steady_rate_below_what_was_asked_for_is_that_of_the_link(
    shares: list[float], held: bool, full: bool
) -> None:
    found = summarize_moments(send(shares, held=held), 0, RATE)
    assert found["full"] is full
    if shares[-1] == shares[-5]:
        assert found["bytes_per_s"] == pytest.approx(shares[-1] * RATE, rel=0.01)


def test_the_rate_counts_from_where_the_path_was_full() -> None:
    found = summarize_moments(send([0.9] * 4 + [0.3] * 14), 4, RATE)
    assert found == {"bytes_per_s": pytest.approx(0.3 * RATE, rel=0.01), "full": True}


def test_of_bursts_that_grow_each_passes_in_the_time_until_the_next() -> None:
    """As a class of HTB lets large segments pass: each part takes 4 ms, after it has passed."""
    seen, at = [Moment(0, 0.0, True)], 0.0
    for parts in (1, 2, 3, 4, 5, 6):
        at += 0.004 * (parts - 1)
        seen.append(Moment(seen[-1].count + parts * 10_000, at, True, burst=True))
    found = summarize_moments(seen, 3, RATE)
    assert found == {"bytes_per_s": pytest.approx(10_000 / 0.004, rel=0.01), "full": True}


@pytest.mark.parametrize(("moments", "full"), [(1, 0), (3, 0), (10, 9)])
def test_too_little_says_nothing(moments: int, full: int) -> None:
    found = summarize_moments(send([0.5] * moments)[:moments], full, RATE)
    assert found["bytes_per_s"] is None
