"""How a command ends well that goes on until it is told to end."""

import contextlib
import queue
import signal
from collections.abc import Callable, Iterator
from types import FrameType


@contextlib.contextmanager
def told(every: float) -> Iterator[Callable[[], bool]]:
    """A wait of ``every`` seconds that says whether SIGINT or SIGTERM came; it ends at once when one comes."""
    # The one queue of the standard library that a signal handler may put into at any moment.
    ends: queue.SimpleQueue[int] = queue.SimpleQueue()

    def end(number: int, _frame: FrameType | None) -> None:
        if not ends.empty():
            raise KeyboardInterrupt  # asked twice, so what is under way is not waited for
        ends.put(number)

    def wait() -> bool:
        try:
            ends.get(timeout=every)
        except queue.Empty:
            return False
        return True

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield wait
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
