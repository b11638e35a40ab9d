# SPDX-License-Identifier: Apache-2.0
"""Control of a running watch by keys or signals; safe from any thread and from signal handlers."""

import queue
import threading
from enum import Enum, auto


class ControlRequest(Enum):
    """A request to a running watch."""

    STOP = auto()
    NOW = auto()


class Control:
    """Control of one watch.

    ``stop_requested``: no further action begins. ``paused``: nothing is planned or applied; hosts are still
    sampled.
    """

    def __init__(self) -> None:
        self.stop_requested = threading.Event()
        self.paused = False
        # The only queue of the standard library that a signal handler may use at any moment.
        self._wishes: queue.SimpleQueue[ControlRequest] = queue.SimpleQueue()

    def stop(self) -> None:
        """End after the work in progress."""
        self.stop_requested.set()
        self._wishes.put(ControlRequest.STOP)

    def now(self) -> None:
        """Begin the next cycle at once; it plans even while paused."""
        self._wishes.put(ControlRequest.NOW)

    def pause(self) -> None:
        """Toggle pause."""
        self.paused = not self.paused

    def wait(self, seconds: float) -> ControlRequest | None:
        """The next request within ``seconds``; None if there was none."""
        try:
            return self._wishes.get(timeout=seconds)
        except queue.Empty:
            return None
