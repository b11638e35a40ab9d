# SPDX-License-Identifier: Apache-2.0
"""Restart back-off, without waiting."""

from edgectl.agent.supervise import backoff


def delays(count: int, *, apart: float = 1.0, jitter: float = 0.0) -> list[float | None]:
    """Delays after runs that fail every ``apart`` seconds."""
    history: list[float] = []
    found = []
    for number in range(count):
        found.append(backoff.compute_delay(history, number * apart, jitter))
        history.append(number * apart)
    return found


def test_doubles_and_gives_up_after_five_restarts_in_ten_minutes() -> None:
    assert delays(6) == [1.0, 2.0, 4.0, 8.0, 16.0, None]


def test_grows_to_five_minutes_where_failures_are_rare() -> None:
    # Every 151 s: at most four restarts fall within 600 s before each failure, so restarts continue.
    assert delays(11, apart=151.0) == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 300.0, 300.0]


def test_jitter_is_a_quarter() -> None:
    assert delays(1, jitter=1.0) == [1.25]
    assert delays(1, jitter=-1.0) == [0.75]


def test_health_is_forgiven_at_600_seconds() -> None:
    assert backoff.select_history([1.0, 2.0], 599.9) == [1.0, 2.0]
    assert backoff.select_history([1.0, 2.0], 600.0) == []


def test_boundary_of_the_window() -> None:
    assert backoff.compute_delay([0.0, 1.0, 2.0, 3.0, 4.0], 599.9, 0.0) is None
    assert backoff.compute_delay([0.0, 1.0, 2.0, 3.0, 4.0], 600.0, 0.0) == 32.0
