"""How a command ends well that goes on until it is told to end."""

import contextlib
import queue
import signal
from collections.abc import Callable, Iterator
from types import FrameType

from edgectl.cli import console
from edgectl.errors import UsageError
from edgectl.usecases.control import Control

_MIN_PERIOD_S = 0.1


def parse_every_option(text: str) -> float:
    """Seconds between two looks, as ``--every`` states them.

    Raises:
        UsageError: it is no duration, or so short that it would do nothing but look.
    """
    from edgectl.cli.connect import parse_duration_option

    every = parse_duration_option(text, "--every")
    if every < _MIN_PERIOD_S:
        raise UsageError(f"--every {text} is too often", hint="write 100ms or more")
    return every


@contextlib.contextmanager
def catch_stop_signals(every: float) -> Iterator[Callable[[], bool]]:
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

    with _install_handlers(end):
        yield wait


@contextlib.contextmanager
def stop_control_on_signal(control: Control, saying: str = "") -> Iterator[list[int]]:
    """The first Ctrl-C or SIGTERM lets what is under way finish, the second stops at once; the list tells which came.

    ``saying`` is told at the first.
    """
    came: list[int] = []

    def heard(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        if len(came) > 1:
            raise KeyboardInterrupt
        control.stop()
        if saying:
            console.print_message(saying)

    with _install_handlers(heard):
        yield came


@contextlib.contextmanager
def _install_handlers(heard: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Ctrl-C and SIGTERM go to ``heard``; afterwards to whom they went before."""
    before = {number: signal.signal(number, heard) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
