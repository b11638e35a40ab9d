# SPDX-License-Identifier: Apache-2.0
"""The thread that says to all agents that stay, each `frames.PULSE_S`, that their manager is still there.

One thread for each would wake up, wait for its turn and write ten bytes: most of what a pulse costs
(ADR 192).
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from edgectl.agent.link.frames import PULSE_S

_GUARD = threading.Lock()
_SENDERS: list[Callable[[], None]] = []
_RUNNING: list[threading.Thread] = []


@contextmanager
def keep_pulsing(send: Callable[[], None]) -> Iterator[None]:
    """Call ``send``, which waits for nothing, each `PULSE_S` within the block."""
    with _GUARD:
        _SENDERS.append(send)
        if not _RUNNING:
            _RUNNING.append(threading.Thread(target=_send_pulses, name="edgectl-pulse", daemon=True))
            _RUNNING[0].start()
    try:
        yield
    finally:
        with _GUARD:
            _SENDERS.remove(send)


def _send_pulses() -> None:
    """Send pulses until nobody wants any."""
    while True:
        time.sleep(PULSE_S - time.monotonic() % PULSE_S)
        with _GUARD:
            due = list(_SENDERS)
            if not due:
                _RUNNING.clear()
                return
        for send in due:
            # One that fails costs its own host alone.
            with suppress(Exception):
                send()
