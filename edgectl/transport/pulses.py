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
# Writes a pulse; the seconds until the next one, and what lets go what may be held back of it.
Sender = Callable[[], tuple[float, Callable[[], None]]]
# By what sends a pulse: s until the next one.
_SENDERS: dict[Sender, float] = {}
_RUNNING: list[threading.Thread] = []


def compute_pulse_s(repeat_s: float | None) -> float:
    """Seconds between two pulses over a line that repeats what was lost after ``repeat_s``; None: unknown."""
    is_near = repeat_s is not None and NEAR_PULSE_S + _REPEATS * repeat_s <= SILENCE_S
    return NEAR_PULSE_S if is_near else PULSE_S


@contextmanager
def keep_pulsing(send: Sender) -> Iterator[None]:
    """Call ``send``, which waits for nothing, within the block.

    All that wait for equally long are called together, and then let go what they have written: a packet wakes
    programs up, which take the processor and its caches from the next one (ADR 214).
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
        before, held = now, list[Callable[[], None]]()
        for send in due:
            period = PULSE_S
            # One that fails costs its own host alone.
            with suppress(Exception):
                period, let_go = send()
                held.append(let_go)
            with _GUARD:
                if send in _SENDERS:
                    _SENDERS[send] = period
        for let_go in held:
            with suppress(Exception):
                let_go()
