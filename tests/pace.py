# SPDX-License-Identifier: Apache-2.0
"""Slowdown of the machine by other load, and timeouts that allow for it.

The slowdown is measured once, at the start of a test session; workers and child processes read it from the
environment. It multiplies timeouts of expected events and of tests, and so does the load at the time where that is
more: other work may begin after the start. A wait that checks that nothing happens is not scaled.
"""

import os
import time
from functools import cache

VARIABLE = "TESTS_PACE"
# Enough CPU time for several time slices of the scheduler.
WORK_S = 0.2


def measure() -> float:
    """Wall-clock time per CPU time of a fixed amount of work: 1.0 on an idle machine, 15 at load 30 on two cores."""
    wall, cpu = time.monotonic(), time.process_time()
    while (spent := time.process_time() - cpu) < WORK_S:
        sum(range(1000))
    return max(1.0, (time.monotonic() - wall) / spent)


@cache
def pace() -> float:
    """Return the slowdown of this session, at least 1."""
    if VARIABLE not in os.environ:
        os.environ[VARIABLE] = f"{measure():.2f}"
    return float(os.environ[VARIABLE])


def patience(seconds: float) -> float:
    """Scale a timeout in seconds that is chosen for an idle machine."""
    return seconds * max(pace(), os.getloadavg()[0] / (os.cpu_count() or 1))
