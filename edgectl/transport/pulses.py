# SPDX-License-Identifier: Apache-2.0
"""The thread that says to all agents that stay that their manager is still there, each at its own pace.

One thread for each would wake up, wait for its turn and write ten bytes: most of what a pulse costs
(ADR 192).
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from edgectl.agent.link.frames import PULSE_S, SILENCE_S

# Between two pulses to a host whose line repeats what it loses twice in what is left until the host has heard
# nothing for too long (ADR 200).
NEAR_PULSE_S = 0.9
# Repeated after so long, and again after twice as long: the kernel doubles the time.
_REPEATS = 3
_GUARD = threading.Lock()
# By what sends a pulse: s until the next one.
_SENDERS: dict[Callable[[], float], float] = {}
_RUNNING: list[threading.Thread] = []


def compute_pulse_s(repeat_s: float | None) -> float:
    """Seconds between two pulses over a line that repeats what was lost after ``repeat_s``; None: unknown."""
    is_near = repeat_s is not None and NEAR_PULSE_S + _REPEATS * repeat_s <= SILENCE_S
    return NEAR_PULSE_S if is_near else PULSE_S


@contextmanager
def keep_pulsing(send: Callable[[], float]) -> Iterator[None]:
    """Call ``send``, which waits for nothing, within the block; it returns the seconds until the next time.

    All that wait for equally long are called together.
    """
    with _GUARD:
        _SENDERS[send] = PULSE_S
        if not _RUNNING:
            _RUNNING.append(threading.Thread(target=_send_pulses, name="edgectl-pulse", daemon=True))
            _RUNNING[0].start()
    try:
        yield
    finally:
        with _GUARD:
            _SENDERS.pop(send, None)


def _send_pulses() -> None:
    """Send pulses until nobody wants any."""
    before = time.monotonic()
    while True:
        with _GUARD:
            periods = set(_SENDERS.values())
            if not periods:
                _RUNNING.clear()
                return
        time.sleep(max(0.0, min(before - before % each + each for each in periods) - time.monotonic()))
        now = time.monotonic()
        with _GUARD:
            due = [send for send, each in _SENDERS.items() if now // each > before // each]
        before = now
        for send in due:
            period = PULSE_S
            # One that fails costs its own host alone.
            with suppress(Exception):
                period = send()
            with _GUARD:
                if send in _SENDERS:
                    _SENDERS[send] = period
