# SPDX-License-Identifier: Apache-2.0
"""Exponential back-off after failures in a row (pure)."""

# 2 ** 10 times the first pause: beyond it every maximum is reached.
_MAX_DOUBLINGS = 10


def compute_backoff_s(failures: int, *, first_s: float, max_s: float) -> float:
    """Seconds to wait after so many failures in a row (at least 1): doubled each time, at most ``max_s``."""
    return min(first_s * 2.0 ** min(failures - 1, _MAX_DOUBLINGS), max_s)
