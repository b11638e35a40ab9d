"""Signal handling for long-running commands."""

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
    """Parse the seconds between two probes given by ``--every``.

    Raises:
        UsageError: it is not a duration, or too short.
    """
    from edgectl.cli.connect import parse_duration_option

    every = parse_duration_option(text, "--every")
    if every < _MIN_PERIOD_S:
        raise UsageError(f"--every {text} is too short", hint="write 100ms or more")
    return every


@contextlib.contextmanager
def catch_stop_signals(every: float) -> Iterator[Callable[[], bool]]:
    """A wait of ``every`` seconds that returns whether SIGINT or SIGTERM came; a signal ends it at once."""
    # The only queue of the standard library that a signal handler may use at any moment.
    ends: queue.SimpleQueue[int] = queue.SimpleQueue()

    def end(number: int, _frame: FrameType | None) -> None:
        if not ends.empty():
            raise KeyboardInterrupt  # the second signal: do not wait for the work in progress
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
def stop_control_on_signal(control: Control, message: str = "") -> Iterator[list[int]]:
    """The first Ctrl-C or SIGTERM lets the work in progress finish, the second stops at once; the list
    receives the signals.

    ``saying`` is printed at the first.
    """
    came: list[int] = []

    def heard(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        if len(came) > 1:
            raise KeyboardInterrupt
        control.stop()
        if message:
            console.print_message(message)

    with _install_handlers(heard):
        yield came


@contextlib.contextmanager
def _install_handlers(heard: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Install ``heard`` as handler of Ctrl-C and SIGTERM; restore the earlier handlers afterwards."""
    before = {number: signal.signal(number, heard) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
