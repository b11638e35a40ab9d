# SPDX-License-Identifier: Apache-2.0
"""Requests of events to the person at the terminal."""

import select
import sys
import threading
import time

from edgectl.units import format_duration
from edgectl.views.progress import print_progress_line
from edgectl.views.text import escape_unprintable

_PAUSE_S = 0.2


def ask_person(text: str, seconds: float, ended: threading.Event) -> bool:
    """Print ``text`` and wait for Enter, ``seconds`` at most; False where nobody confirmed.

    Without a terminal the time passes, so that the mission takes as long as with one.
    """
    allowed = format_duration(seconds)
    if sys.stdin is None or not sys.stdin.isatty():
        print_progress_line(escape_unprintable(f"{text} (within {allowed}; stdin is not a terminal)"))
        ended.wait(seconds)
        return False
    print_progress_line(escape_unprintable(f"{text} (then press Enter, within {allowed})"))
    deadline = time.monotonic() + seconds
    while not ended.is_set() and (left := deadline - time.monotonic()) > 0:
        ready, _, _ = select.select([sys.stdin], [], [], min(left, _PAUSE_S))
        if ready:
            return sys.stdin.readline() != ""
    return False
