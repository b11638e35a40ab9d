"""What every text form shares: columns without borders, colour that never carries meaning alone, harmless characters."""

import os
import shutil
import textwrap
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TextIO

_STYLES = {"good": "32", "bad": "31", "warn": "33", "dim": "2", "bold": "1", "name": "36"}
_NARROWEST_LAST_COLUMN = 24


class Cell(NamedTuple):
    """One field of a table with its style (a key of the style table, empty for none)."""

    text: str
    style: str = ""


Row = Sequence[str | Cell]


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How text may look. ``width`` in columns; None: not a terminal, so nothing is wrapped."""

    colour: bool = False
    width: int | None = None


PLAIN = Look()


def look_of(stream: TextIO) -> Look:
    """The look that ``stream`` can show: NO_COLOR and TERM=dumb switch colour off, FORCE_COLOR switches it on."""
    terminal = stream.isatty()
    width = shutil.get_terminal_size().columns if terminal else None
    if os.environ.get("NO_COLOR"):
        return Look(width=width)
    if os.environ.get("FORCE_COLOR"):
        return Look(colour=True, width=width)
    return Look(colour=terminal and os.environ.get("TERM") != "dumb", width=width)


def harmless(text: str) -> str:
    """``text`` with every control and format character written out, so that no host can steer the terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else _written_out(c) for c in text)


def log_text(data: bytes) -> str:
    """A task's own output, lines and tabs kept, everything else that could steer a terminal written out."""
    text = data.decode("utf-8", "replace")
    return "".join(c if c in "\n\t" or c.isprintable() else _written_out(c) for c in text)


def _written_out(character: str) -> str:
    return {"\n": "\\n", "\t": "\\t", "\r": "\\r"}.get(character) or character.encode("unicode_escape", "backslashreplace").decode("ascii")


def paint(text: str, style: str, look: Look) -> str:
    """``text`` in ``style`` where colour is allowed."""
    return f"\x1b[{_STYLES[style]}m{text}\x1b[0m" if look.colour and style and text else text


def columns(rows: Iterable[Row], look: Look = PLAIN, *, right: Collection[int] = (), gap: str = "  ") -> str:
    """Rows as aligned columns, each line ended by a newline. ``right`` lists the columns aligned to the right.

    On a terminal the last column is wrapped under itself where it would pass the edge.
    """
    cells = [[_cell(field) for field in row] for row in rows]
    if not cells:
        return ""
    count = max(len(row) for row in cells)
    widths = [max(len(row[i].text) if i < len(row) else 0 for row in cells) for i in range(count)]
    return "".join(line + "\n" for row in cells for line in _lines(row, widths, look, right, gap))


def _cell(field: str | Cell) -> Cell:
    text, style = field if isinstance(field, Cell) else (field, "")
    return Cell(harmless(text), style)


def _lines(row: list[Cell], widths: list[int], look: Look, right: Collection[int], gap: str) -> list[str]:
    *head, last = row
    start = "".join(_padded(cell, widths[i], look, to_right=i in right) + gap for i, cell in enumerate(head))
    indent = sum(widths[: len(head)]) + len(gap) * len(head)
    texts = _wrapped(last.text, indent, look)
    if len(row) == len(widths) and len(head) in right:
        texts = [texts[0].rjust(widths[-1]), *texts[1:]]
    first, *rest = [paint(text, last.style, look) for text in texts]
    return [(start + first).rstrip(), *(" " * indent + text for text in rest)]


def _padded(cell: Cell, width: int, look: Look, *, to_right: bool) -> str:
    space = " " * (width - len(cell.text))
    text = paint(cell.text, cell.style, look)
    return space + text if to_right else text + space


def _wrapped(text: str, indent: int, look: Look) -> list[str]:
    room = None if look.width is None else look.width - indent
    if room is None or len(text) <= room or room < _NARROWEST_LAST_COLUMN:
        return [text]
    return textwrap.wrap(text, room, break_on_hyphens=False) or [""]
