"""What a person or a signal wants of a running watch; from any thread, and from a signal handler."""

import queue
import threading
from enum import Enum, auto


class ControlRequest(Enum):
    """What was asked for."""

    STOP = auto()
    NOW = auto()


class Control:
    """``stop_requested``: no further action begins. ``paused``: nothing is planned or carried out; samples are taken all the same."""

    def __init__(self) -> None:
        self.stop_requested = threading.Event()
        self.paused = False
        # The one queue of the standard library that a signal handler may put into at any moment.
        self._wishes: queue.SimpleQueue[ControlRequest] = queue.SimpleQueue()

    def stop(self) -> None:
        """End after what is under way."""
        self.stop_requested.set()
        self._wishes.put(ControlRequest.STOP)

    def now(self) -> None:
        """Begin the next cycle at once; it plans even while paused."""
        self._wishes.put(ControlRequest.NOW)

    def pause(self) -> None:
        """Pause, or go on."""
        self.paused = not self.paused

    def wait(self, seconds: float) -> ControlRequest | None:
        """What was wished for within ``seconds``, None where nothing was."""
        try:
            return self._wishes.get(timeout=seconds)
        except queue.Empty:
            return None
