"""Single keys from the terminal, while something else runs."""

import contextlib
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator

_LOOK_S = 0.2


def in_front() -> bool:
    """Whether standard input is a terminal whose keys are ours: a command in the background may not touch it."""
    if not sys.stdin.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:
        return True  # a terminal, but not the one that controls jobs


@contextlib.contextmanager
def keys(heard: Callable[[str], None]) -> Iterator[None]:
    """Call ``heard`` with each key, from a thread of its own; afterwards the terminal is as it was before."""
    if not in_front():
        yield
        return
    descriptor, over = sys.stdin.fileno(), threading.Event()
    before = termios.tcgetattr(descriptor)
    reader = threading.Thread(target=_read, args=(descriptor, heard, over), daemon=True)
    try:
        tty.setcbreak(descriptor)
        reader.start()
        yield
    finally:
        over.set()
        reader.join()
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _read(descriptor: int, heard: Callable[[str], None], over: threading.Event) -> None:
    with contextlib.suppress(OSError):
        while not over.is_set():
            if not select.select([descriptor], [], [], _LOOK_S)[0]:
                continue
            pressed = os.read(descriptor, 64)
            if not pressed:
                return
            for key in pressed.decode("utf-8", "replace"):
                heard(key)
