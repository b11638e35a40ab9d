"""When to start a failed command again: pure, so that the rule can be tested without waiting.

Delay 1 s doubling to 300 s, +-25 % jitter; forgotten after 600 s of health; at most 5 restarts in 600 s, then ``crashloop``.
"""

FIRST_S, LONGEST_S = 1.0, 300.0
JITTER = 0.25
HEALTHY_S = 600.0
MOST, WITHIN_S = 5, 600.0


def kept(history: list, ran_s: float) -> list:
    """The restart times that still count after a run of ``ran_s`` seconds."""
    return [] if ran_s >= HEALTHY_S else list(history)


def delay(history: list, now: float, jitter: float):
    """Seconds to wait before the next start; None for a crash loop. ``history``: restart times, ``jitter``: -1..1."""
    if sum(1 for when in history if now - when < WITHIN_S) >= MOST:
        return None
    return min(LONGEST_S, FIRST_S * 2 ** min(len(history), 16)) * (1.0 + JITTER * jitter)
