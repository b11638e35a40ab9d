# SPDX-License-Identifier: Apache-2.0
"""Text layout of all outputs: aligned columns, optional colour, escaped control characters."""

import codecs
import os
import re
import shutil
import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, TextIO

from edgectl.dataclass import dataclass

# "head" is a heading, "spare" that of a column which is left out where it has no value.
_ANSI_STYLES = {
    "good": "32", "bad": "31", "warn": "33", "dim": "2", "bold": "1", "name": "36", "head": "1", "spare": "1",
}  # fmt: skip
_NARROWEST_LAST_COLUMN = 24
_BELOW_INDENT = 4
# CSI; then OSC and other strings, which end within their line or are text; then all others (ECMA-48).
_CONTROL_SEQUENCE = re.compile(
    r"(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]"
    r"|(?:\x1b[\]PX^_]|[\x90\x98\x9d-\x9f])[^\x07\x1b\x9c\n]*(?:\x07|\x1b\\|\x9c)"
    r"|\x1b[ -/]*[0-~]"
)
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
# One of them that the end of the text cuts.
_BEGUN_SEQUENCE = re.compile(
    r"(?:\x1b[ -/]*|(?:\x1b\[|\x9b)[0-?]{0,256}[ -/]{0,256}"
    r"|(?:\x1b[\]PX^_]|[\x90\x98\x9d-\x9f])[^\x07\x1b\x9c\n]{0,4096}\x1b?)\Z"
)
_FIELD_BREAKS = re.compile(r"(?<=[,\s])")


class Cell(NamedTuple):
    """One field of a table with its style (a key of the style table, empty for none)."""

    text: str
    style: str = ""


Row = Sequence[str | Cell]


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderOptions:
    """Capabilities of the stream.

    ``width`` in columns; None: not a terminal, so nothing is wrapped. ``unicode``: bars and marks beyond
    ASCII.
    """

    colour: bool = False
    width: int | None = None
    unicode: bool = False


PLAIN = RenderOptions()


def detect_render_options(stream: TextIO) -> RenderOptions:
    """Capabilities of ``stream``: NO_COLOR, TERM=dumb and CI switch colour off, FORCE_COLOR turns it on."""
    terminal = stream.isatty()
    dumb = os.environ.get("TERM") == "dumb"
    coloured = bool(os.environ.get("FORCE_COLOR")) or (terminal and not dumb and not is_ci())
    return RenderOptions(
        colour=coloured and not os.environ.get("NO_COLOR"),
        width=shutil.get_terminal_size().columns if terminal else None,
        unicode=terminal and not dumb and _can_show_unicode(stream),
    )


def is_ci() -> bool:
    """Whether a CI job runs this: nobody is there to be asked, and nothing is drawn in place."""
    return os.environ.get("CI", "").lower() not in ("", "0", "false")


def render_fleet_line(fleet: str, look: RenderOptions) -> str:
    """The name of the fleet, where it is known, above a table on a terminal; elsewhere nothing."""
    if look.width is None or not fleet:
        return ""
    return style_text(f"Fleet {escape_unprintable(fleet)}", "bold", look) + "\n"


def _can_show_unicode(stream: TextIO) -> bool:
    """Whether block glyphs show: not with NO_UNICODE or the C locale (Python itself takes C for UTF-8)."""
    plain = os.environ.get("NO_UNICODE") or os.environ.get("LC_ALL") in ("C", "POSIX")
    return not plain and (stream.encoding or "").lower().replace("-", "") == "utf8"


def escape_unprintable(text: str) -> str:
    """``text`` with every control and format character escaped, so that no host can control the terminal."""
    return (
        text if text.isprintable() else "".join(c if c.isprintable() else _escape_character(c) for c in text)
    )


def decode_log_output(data: bytes) -> str:
    """Output of a task: lines and tabs kept, every other control character escaped."""
    text = data.decode("utf-8", "replace")
    return "".join(c if c in "\n\t" or c.isprintable() else _escape_character(c) for c in text)


def clean_log_text(text: str) -> str:
    """Output of a task without control sequences and control characters but lines and tabs; what else changes
    the look of a terminal, such as the direction of text, is escaped.
    """
    if text.isprintable():
        return text
    plain = _CONTROL.sub("", _CONTROL_SEQUENCE.sub("", text))
    return "".join(c if c in "\n\t" or c.isprintable() else _escape_character(c) for c in plain)


def decode_log(parts: Iterable[bytes], *, raw: bool = False) -> Iterator[str]:
    """Output of a task as text, part by part, cleaned unless ``raw``; characters and control sequences may be
    cut anywhere between two parts.
    """
    decoder, held = codecs.getincrementaldecoder("utf-8")("replace"), ""
    for part in parts:
        text = held + decoder.decode(part)
        begun = None if raw else _BEGUN_SEQUENCE.search(text)
        cut = len(text) if begun is None else begun.start()
        held = text[cut:]
        yield text[:cut] if raw else clean_log_text(text[:cut])
    rest = held + decoder.decode(b"", final=True)
    yield rest if raw else clean_log_text(rest)


def prefix_lines(parts: Iterable[str], prefix: str) -> Iterator[str]:
    """``parts`` of a text with ``prefix`` at the beginning of each line; the last one is ended."""
    begun = False
    for part in filter(None, parts):
        ended = part.endswith("\n")
        lines = part.removesuffix("\n").replace("\n", "\n" + prefix)
        yield ("" if begun else prefix) + lines + ("\n" if ended else "")
        begun = not ended
    if begun:
        yield "\n"


def _escape_character(character: str) -> str:
    return {"\n": "\\n", "\t": "\\t", "\r": "\\r"}.get(character) or character.encode(
        "unicode_escape", "backslashreplace"
    ).decode("ascii")


def style_text(text: str, style: str, look: RenderOptions) -> str:
    """``text`` in ``style`` where colour is allowed."""
    return f"\x1b[{_ANSI_STYLES[style]}m{text}\x1b[0m" if look.colour and style and text else text


def render_columns(
    rows: Iterable[Row],
    look: RenderOptions = PLAIN,
    *,
    right: Collection[int] = (),
    gap: str = "  ",
    wrap: Collection[int] = (),
    least: Sequence[int] = (),
    below: bool = False,
) -> str:
    """Rows as aligned columns, each line ended by a newline. ``right``: columns aligned to the right.

    On a terminal that is too narrow the last column is wrapped, and headings and those in ``wrap``, each
    under itself and between its words; a name is never split. Where that leaves no room for the last one,
    what is too long of it stands on lines of its own; with ``below``, all of it. A table that is still too
    wide is left as it is. ``least``: minimum widths of the columns.
    """
    cells = [[_to_safe_cell(field) for field in row] for row in rows]
    if not cells:
        return ""
    kept = _list_kept_columns(cells)
    cells = [_select_cells(row, kept) for row in cells]
    right, wrap = ({n for n, column in enumerate(kept) if column in chosen} for chosen in (right, wrap))
    least = [least[column] for column in kept if column < len(least)]
    natural = _measure_cell_widths(cells, least)
    floors = {
        i: _measure_narrowest(_select_column(cells, i), may_wrap=i in wrap) for i in range(len(natural) - 1)
    }
    widths = _shrink_widths([*natural[:-1], 0] if below else natural, look, floors, gap)
    return "".join(line + "\n" for row in cells for line in _render_row_lines(row, widths, look, right, gap))


def measure_column_widths(rows: Iterable[Row]) -> list[int]:
    """Width of each column where nothing is wrapped."""
    cells = [[_to_safe_cell(field) for field in row] for row in rows]
    kept = _list_kept_columns(cells)
    return _measure_cell_widths([_select_cells(row, kept) for row in cells], ())


def _list_kept_columns(cells: list[list[Cell]]) -> list[int]:
    """The columns without those whose heading is spare and which have no value."""
    spare = [column for column, cell in enumerate(cells[0]) if cell.style == "spare"] if cells else []
    empty = {
        column
        for column in spare
        if all(row[column].text in ("", "-") for row in cells[1:] if column < len(row))
    }
    return [column for column in range(max(map(len, cells), default=0)) if column not in empty]


def _select_cells(row: list[Cell], columns: Sequence[int]) -> list[Cell]:
    return [row[column] for column in columns if column < len(row)]


def compute_remaining_width(
    rows: Iterable[Row], look: RenderOptions, gap: str = "  ", *, wrap_headings: bool = False
) -> int:
    """Columns that are left on the terminal for one more column; without a terminal, none."""
    if look.width is None:
        return 0
    widths = _measure_widths_below_headings(rows) if wrap_headings else measure_column_widths(rows)
    return max(0, look.width - sum(width + len(gap) for width in widths))


def _measure_widths_below_headings(rows: Iterable[Row]) -> list[int]:
    """Width of each column where its heading stands on as many lines as it has words."""
    cells = [[_to_safe_cell(field) for field in row] for row in rows]
    return [
        _measure_narrowest(_select_column(cells, column), may_wrap=False)
        for column in _list_kept_columns(cells)
    ]


def is_within_width(rows: Iterable[Row], look: RenderOptions, gap: str = "  ") -> bool:
    """Whether rows as columns fit the terminal."""
    widths = measure_column_widths(rows)
    return look.width is None or _sum_widths(widths, gap) <= look.width


def _measure_cell_widths(cells: list[list[Cell]], least: Sequence[int]) -> list[int]:
    count = max([len(least), *(len(row) for row in cells)])
    given = [*least, *[0] * count][:count]
    return [max([given[i], *(len(row[i].text) for row in cells if i < len(row))]) for i in range(count)]


def _sum_widths(widths: Sequence[int], gap: str) -> int:
    return sum(widths) + len(gap) * (len(widths) - 1)


def _shrink_widths(widths: list[int], look: RenderOptions, floors: Mapping[int, int], gap: str) -> list[int]:
    """Widths that fit the terminal as far as possible. ``floors``: minimum widths by column."""
    excess = _sum_widths(widths, gap) - look.width if look.width is not None else 0
    if excess <= 0:
        return widths
    fitted, spare = list(widths), widths[-1] - min(widths[-1], _NARROWEST_LAST_COLUMN)
    give = sum(max(0, widths[column] - floor) for column, floor in floors.items())
    if excess > spare + give:
        spare = widths[-1]  # the last column goes below; only the others have to fit
    while excess > spare and give > 0:
        widest = max(
            (column for column, floor in floors.items() if fitted[column] > floor),
            key=lambda column: fitted[column],
        )
        fitted[widest] -= 1
        excess, give = excess - 1, give - 1
    if excess > spare:
        return fitted  # too wide all the same: names stay whole
    return [*fitted[:-1], max(0, fitted[-1] - max(0, excess))]


def _to_safe_cell(field: str | Cell) -> Cell:
    text, style = field if isinstance(field, Cell) else (field, "")
    return Cell(escape_unprintable(text), style)


def _render_row_lines(
    row: list[Cell], widths: list[int], look: RenderOptions, right: Collection[int], gap: str
) -> list[str]:
    """One row, as many lines as its tallest cell has."""
    *head, last = row
    whole = len(row) == len(widths)
    indent = sum(widths[: len(head)]) + len(gap) * len(head)
    room = widths[-1] if whole or look.width is None else look.width - indent
    aside = whole and room < min(len(last.text), _NARROWEST_LAST_COLUMN)
    tall = [_wrap_field(cell.text, widths[i]) for i, cell in enumerate(head)]
    final = [] if aside else _wrap_sentence(last.text, room) if look.width is not None else [last.text]
    lines = []
    for number in range(max(len(texts) for texts in [*tall, final, [""]])):
        padded = (
            _pad_cell(_get_line_or_empty(texts, number), head[i], widths[i], look, to_right=i in right) + gap
            for i, texts in enumerate(tall)
        )
        end = _get_line_or_empty(final, number)
        width = widths[-1] if whole and len(head) in right else len(end)
        lines.append(("".join(padded) + _pad_cell(end, last, width, look, to_right=True)).rstrip())
    under = _wrap_sentence(last.text, (look.width or 0) - _BELOW_INDENT) if aside and last.text != "-" else []
    return lines + [" " * _BELOW_INDENT + style_text(text, last.style, look) for text in under if text]


def _get_line_or_empty(texts: list[str], number: int) -> str:
    return texts[number] if number < len(texts) else ""


def _pad_cell(text: str, cell: Cell, width: int, look: RenderOptions, *, to_right: bool) -> str:
    space = " " * (width - len(text))
    painted = style_text(text, cell.style, look)
    return space + painted if to_right else painted + space


def _wrap_sentence(text: str, width: int) -> list[str]:
    """A sentence on lines. No break at hyphens, for it may name options."""
    if len(text) <= width or width < 1:
        return [text]
    return textwrap.wrap(text, width, break_on_hyphens=False) or [""]


def _wrap_field(text: str, width: int) -> list[str]:
    """A field on lines: lists break after commas; a name stays whole."""
    lines = [""]
    for word in _FIELD_BREAKS.split(text):
        if lines[-1] and len(lines[-1]) + len(word.rstrip()) > width:
            lines.append("")
        lines[-1] += word
    return [line.rstrip() for line in lines]


def _select_column(cells: list[list[Cell]], column: int) -> list[Cell]:
    return [row[column] for row in cells if column < len(row)]


def _measure_narrowest(column: Iterable[Cell], *, may_wrap: bool) -> int:
    """Width of a column where its headings, and its fields if they may wrap, stand on several lines."""
    return max(
        (
            _measure_longest_word(cell.text)
            if may_wrap or cell.style in ("head", "spare")
            else len(cell.text)
            for cell in column
        ),
        default=0,
    )


def _measure_longest_word(text: str) -> int:
    return max(len(word.rstrip()) for word in _FIELD_BREAKS.split(text))


def wrap_text(text: str, look: RenderOptions, indent: int = 2) -> str:
    """One line of text, broken between words where the terminal ends; what follows is indented."""
    if look.width is None or len(text) <= look.width:
        return text + "\n"
    lines = textwrap.wrap(
        text, look.width, subsequent_indent=" " * indent, break_on_hyphens=False, break_long_words=False
    )
    return "\n".join(lines) + "\n"


def render_header(parts: Iterable[str], look: RenderOptions = PLAIN) -> str:
    """The line above a table."""
    line = (" · " if look.unicode else ", ").join(parts)
    return (
        "\n".join(
            style_text(each, "bold", look)
            for each in wrap_text(line[:1].upper() + line[1:], look).splitlines()
        )
        + "\n"
    )
