# SPDX-License-Identifier: Apache-2.0
"""Signal handling for commands that change hosts or run until they are stopped."""

import contextlib
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

from edgectl.cli import console
from edgectl.errors import UsageError
from edgectl.usecases.control import Control

_MIN_PERIOD_S = 0.1


def parse_every_option(text: str) -> float:
    """Seconds from one sample to the next, as ``--every`` states them.

    Raises:
        UsageError: it is no duration, or too short.
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
    """The first SIGINT or SIGTERM lets the work in progress finish, the second stops at once.

    The list names the signals that came. ``message`` is printed at the first.
    """
    with _stop_in_two_steps(control.stop, message) as came:
        yield came


@contextlib.contextmanager
def request_stop_on_signal(stop_requested: threading.Event) -> Iterator[None]:
    """The first SIGINT or SIGTERM lets the running actions finish, the second stops at once."""
    message = "finishing the running actions; press Ctrl-C again to stop at once"
    with _stop_in_two_steps(stop_requested.set, message, stop_requested.is_set):
        yield


@contextlib.contextmanager
def return_on_signal() -> Iterator[None]:
    """Run the block until it ends or the first SIGINT or SIGTERM comes."""

    def end(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    with _install_handlers(end), contextlib.suppress(KeyboardInterrupt):
        yield


@contextlib.contextmanager
def _stop_in_two_steps(
    stop: Callable[[], object], message: str, is_stopping: Callable[[], bool] = lambda: False
) -> Iterator[list[int]]:
    """The list names the signals that came; a signal while ``is_stopping`` is not the first."""
    came: list[int] = []

    def handle(number: int, _frame: FrameType | None) -> None:
        second = bool(came) or is_stopping()
        came.append(number)
        if second:
            raise KeyboardInterrupt
        stop()
        if message:
            console.print_message(message)

    with _install_handlers(handle):
        yield came


@contextlib.contextmanager
def _install_handlers(handle: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle SIGINT and SIGTERM within the block; then restore the handlers from before."""
    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
