# SPDX-License-Identifier: Apache-2.0
"""Bound of the time that one host may take of a run for tasks that left the files."""

import threading
import time
from collections.abc import Callable

from edgectl.errors import HostError

# A host may report any number of such tasks, and let each stop take as long as it likes.
STOP_BUDGET_S = 60.0


class BudgetSpentError(HostError):
    """The stops on a host have taken their part of this run; the rest is left to the next one."""


class StopBudget:
    """Time since the first such stop on each host; safe from any thread."""

    def __init__(self, seconds: float = STOP_BUDGET_S, clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds, self._clock = seconds, clock
        self._began: dict[str, float] = {}
        self._lock = threading.Lock()

    def check(self, host: str) -> None:
        """Begin one more stop on ``host``.

        Raises:
            BudgetSpentError: the time is over; nothing was begun.
        """
        with self._lock:
            now = self._clock()
            spent = now - self._began.setdefault(host, now)
        if spent >= self._seconds:
            raise BudgetSpentError(
                f"stops of tasks that left the files have taken {self._seconds:g} s on {host} in this run",
                hint="apply again for the rest",
                host=host,
            )
