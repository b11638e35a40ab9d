# SPDX-License-Identifier: Apache-2.0
"""Key presses and full-screen text on the terminal."""

import contextlib
import os
import select
import shutil
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator

_KEY_POLL_S = 0.2


def is_foreground() -> bool:
    """Whether stdin is a terminal in whose foreground this command runs; a background command must not change
    it.
    """
    if not sys.stdin.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:
        return True  # a terminal, but not the controlling one


@contextlib.contextmanager
def listen_for_keys(heard: Callable[[str], None]) -> Iterator[None]:
    """Call ``heard`` with each key from a thread; the terminal is restored afterwards."""
    if not is_foreground():
        yield
        return
    descriptor, over = sys.stdin.fileno(), threading.Event()
    before = termios.tcgetattr(descriptor)
    reader = threading.Thread(target=_read_keys, args=(descriptor, heard, over), daemon=True)
    try:
        tty.setcbreak(descriptor)
        reader.start()
        yield
    finally:
        over.set()
        reader.join()
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _read_keys(descriptor: int, heard: Callable[[str], None], over: threading.Event) -> None:
    with contextlib.suppress(OSError):
        while not over.is_set():
            if not select.select([descriptor], [], [], _KEY_POLL_S)[0]:
                continue
            pressed = os.read(descriptor, 64)
            if not pressed:
                return
            for key in pressed.decode("utf-8", "replace"):
                heard(key)


_ENTER_SCREEN, _LEAVE_SCREEN = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"


def render_screen(text: str, rows: int) -> str:
    """Escape sequences that show ``text`` from the top left corner: at most ``rows`` lines, the last with the
    number of hidden ones.
    """
    lines = text.splitlines()
    if len(lines) > rows:
        lines = [*lines[: rows - 1], f"and {len(lines) - rows + 1} more lines"]
    return "\x1b[H" + "\n".join(f"{line}\x1b[K" for line in lines) + "\x1b[J"


@contextlib.contextmanager
def open_screen() -> Iterator[Callable[[str], None]]:
    """A function that shows texts on the alternate screen. The terminal is restored afterwards in any case,
    with the last text on it.
    """
    shown = ""

    def show(text: str) -> None:
        nonlocal shown
        shown = text
        _write_stdout(render_screen(text, shutil.get_terminal_size().lines))

    _write_stdout(_ENTER_SCREEN)
    try:
        yield show
    finally:
        _write_stdout(_LEAVE_SCREEN + shown)


def _write_stdout(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()
