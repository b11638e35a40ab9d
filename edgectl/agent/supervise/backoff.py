# SPDX-License-Identifier: Apache-2.0
"""Restart back-off of failed commands (pure).

Delay 1 s doubling to 300 s, +-25 % jitter; reset after 600 s of health; at most 5 restarts in 600 s, then
``crashloop``.
"""

FIRST_S, MAX_S = 1.0, 300.0
JITTER = 0.25
HEALTHY_S = 600.0
MAX_RESTARTS, WITHIN_S = 5, 600.0


def select_history(history: "list[float]", ran_s: float) -> "list[float]":
    """Select the restart times that still count after a run of ``ran_s`` seconds."""
    return [] if ran_s >= HEALTHY_S else list(history)


def compute_delay(history: "list[float]", now: float, jitter: float) -> "float | None":
    """Compute the seconds to wait before the next start; None for a crash loop.

    ``history``: restart times, ``jitter``: -1..1.
    """
    if sum(1 for when in history if now - when < WITHIN_S) >= MAX_RESTARTS:
        return None
    return min(MAX_S, FIRST_S * 2.0 ** min(len(history), 16)) * (1.0 + JITTER * jitter)
