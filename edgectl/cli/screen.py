"""A terminal on which one text takes the place of the one before."""

import contextlib
import shutil
import sys
from collections.abc import Callable, Iterator

_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"


def frame(text: str, rows: int) -> str:
    """What shows ``text`` from the top left corner: at most ``rows`` lines, the last of them says how many more there are."""
    lines = text.splitlines()
    if len(lines) > rows:
        lines = [*lines[: rows - 1], f"and {len(lines) - rows + 1} more lines"]
    return "\x1b[H" + "\n".join(f"{line}\x1b[K" for line in lines) + "\x1b[J"


@contextlib.contextmanager
def screen() -> Iterator[Callable[[str], None]]:
    """A way to show texts on a screen of its own. Whatever happens the terminal is as before afterwards, and the last text stands on it."""
    shown = ""

    def show(text: str) -> None:
        nonlocal shown
        shown = text
        _write(frame(text, shutil.get_terminal_size().lines))

    _write(_ENTER)
    try:
        yield show
    finally:
        _write(_LEAVE + shown)


def _write(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()
