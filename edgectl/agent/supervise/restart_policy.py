# SPDX-License-Identifier: Apache-2.0
"""State of a task after the end of its command, and the back-off of its restarts (pure).

Delay 1 s doubling to 300 s, +-25 % jitter; reset after 600 s of health; at most 5 restarts in 600 s, then
``crashloop``.
"""

from ..link import protocol
from ..link.fast_json import Document

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


def decide_end(
    spec: Document, outcome: Document, left: "list[int]", stopped: bool, interrupted: bool = False
) -> "Document | None":
    """Decide what the status says after the end of the main process; None: it is restarted.

    ``outcome``: of `spawn.describe_exit`; ``left``: the processes that could not be ended; ``stopped``: its
    end was wanted; ``interrupted``: another has ended it, so exit code 0 does not mean that it is done.
    """
    if stopped:
        return dict(outcome, state=protocol.STOPPED, left=left)
    if left:
        detail = "processes cannot be stopped: %s" % left
        return {"state": protocol.FAILED, "left": left, "exit_code": outcome["exit_code"], "detail": detail}
    clean, policy = outcome["exit_code"] == 0 and not interrupted, spec.get("restart", "on-failure")
    if clean and spec.get("kind") == "job":
        return dict(outcome, state=protocol.COMPLETED)
    if policy == "never" or (policy == "on-failure" and clean):
        return dict(outcome, state=protocol.FAILED, given_up=policy == "never")
    return None
