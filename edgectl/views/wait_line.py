# SPDX-License-Identifier: Apache-2.0
"""A line on standard error while hosts are asked for longer than a second."""

import contextlib
import sys
import threading
from collections.abc import Iterator, Sequence

from edgectl.model.snapshot import HostSample
from edgectl.names import format_name_list
from edgectl.views.progress import can_show_bar
from edgectl.views.text import is_ci

_DELAY_S = 1.0
_ERASE = "\r\x1b[2K"
# Held by whoever writes to the terminal: a password is asked for in the thread of a host.
_TERMINAL = threading.RLock()


@contextlib.contextmanager
def show_wait(hosts: Sequence[str]) -> Iterator["WaitLine | None"]:
    """A listener for ``hosts`` that answer one by one; after a second its line names those that have not.

    None without a terminal that can erase a line, and in CI jobs: nothing is drawn there.
    """
    if is_ci() or not can_show_bar():
        yield None
        return
    line = WaitLine(hosts)
    timer = threading.Timer(_DELAY_S, line.draw)
    timer.daemon = True
    timer.start()
    try:
        yield line
    finally:
        timer.cancel()
        line.end()


@contextlib.contextmanager
def pause_wait() -> Iterator[None]:
    """Keep the terminal for something else."""
    with _TERMINAL:
        yield


class WaitLine:
    """The line; it is called as each host ends."""

    def __init__(self, hosts: Sequence[str]) -> None:
        self._waiting, self._count = dict.fromkeys(hosts), len(hosts)
        self._drawn = self._ended = False
        # Of those who draw: the one that waits for it knows the latest.
        self._drawing = threading.Lock()

    def __call__(self, name: str, _sample: HostSample, _seconds: float) -> None:
        """Note that ``name`` has ended."""
        self._waiting.pop(name, None)
        if self._drawn:
            self.draw()

    def draw(self) -> None:
        """Draw the line, unless all is over or a password is being asked for."""
        with self._drawing:
            if not _TERMINAL.acquire(blocking=False):
                return
            try:
                if not self._ended:
                    self._drawn = True
                    self._write(self._format())
            finally:
                _TERMINAL.release()

    def _format(self) -> str:
        rest = format_name_list(list(self._waiting)[:3]) + (", .." if len(self._waiting) > 3 else "")
        done = self._count - len(self._waiting)
        return f"{_ERASE}{done} of {self._count} hosts asked" + (f"; waiting for {rest}" if rest else "")

    def end(self) -> None:
        """Erase it."""
        with _TERMINAL:
            self._ended = True
            if self._drawn:
                self._write(_ERASE)

    def _write(self, text: str) -> None:
        with contextlib.suppress(BrokenPipeError):
            sys.stderr.write(text)
            sys.stderr.flush()
