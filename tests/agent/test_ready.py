# SPDX-License-Identifier: Apache-2.0
"""When a ready check is tried again."""

import pytest

from edgectl.agent.supervise.ready import compute_pause_s


@pytest.mark.parametrize(
    ("since_s", "took_s", "pause_s"),
    [
        (0.0, 0.0, 0.1),
        (2.0, 0.01, 0.2),
        (10.0, 0.01, 1.0),
        (100.0, 0.01, 5.0),
        (0.5, 0.3, 1.2),
        (1.0, 9.0, 5.0),
    ],
)
def test_pause_grows_with_the_time_since_the_start_and_with_the_cost(
    since_s: float, took_s: float, pause_s: float
) -> None:
    assert compute_pause_s(since_s, took_s) == pytest.approx(pause_s)


@pytest.mark.parametrize("ready_s", [0.7, 1.01, 3.3, 12.0, 30.0])
def test_what_is_ready_is_seen_at_most_a_tenth_too_late(ready_s: float) -> None:
    tries, at = 0, 0.0
    while at < ready_s:
        tries, at = tries + 1, at + compute_pause_s(at, 0.02)
    assert at - ready_s <= 0.1 + 0.1 * ready_s
    assert tries <= 50
