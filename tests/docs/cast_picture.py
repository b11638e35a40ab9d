# SPDX-License-Identifier: Apache-2.0
"""A recording as one SVG that plays once when it is opened: CSS animations, no script, no font from elsewhere."""

from html import escape
from itertools import pairwise

from rich.color import Color
from rich.style import Style
from rich.text import Text

from tests.docs.recording import Recording
from tests.docs.terminal_theme import THEME

BACK, INK = "#12161b", "#e6edf3"
CELL, LINE, MARGIN = 8.4, 18, 14


def render_cast(recording: Recording) -> str:
    """The picture. Its text only grows: a recording that moves the cursor is refused."""
    groups = _list_groups(recording)
    count = sum(len(lines) for _, lines in groups)
    total = groups[-1][0]
    width, height = recording.width * CELL + 2 * MARGIN, recording.height * LINE + 2 * MARGIN
    drawn, steps, shown = [], [], 0
    for at, lines in groups:
        rows = [_draw_line(line, shown + number) for number, line in enumerate(lines)]
        drawn.append(f'<g style="animation-delay:{at:.2f}s">{"".join(rows)}</g>')
        shown += len(lines)
        steps.append((at / total * 100, max(0, shown - recording.height) * LINE))
    frames = "".join(f"{share:.2f}%{{transform:translateY(-{offset}px)}}" for share, offset in steps)
    last = max(0, count - recording.height) * LINE
    return f"""\
<svg role="img" aria-label="A recording of make demo" viewBox="0 0 {width:.0f} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
text {{ font: 14px "DejaVu Sans Mono", Menlo, Consolas, monospace; fill: {INK}; white-space: pre; }}
.page {{ animation: scroll {total:.2f}s step-end forwards; }}
.page g {{ visibility: hidden; animation: show 1ms forwards; }}
@keyframes show {{ to {{ visibility: visible }} }}
@keyframes scroll {{ {frames} }}
@media (prefers-reduced-motion: reduce) {{
  .page {{ animation: none; transform: translateY(-{last}px) }} .page g {{ animation: none; visibility: visible }}
}}
</style>
<rect width="100%" height="100%" rx="8" fill="{BACK}"/>
<svg x="{MARGIN}" y="{MARGIN}" width="{recording.width * CELL:.0f}" height="{recording.height * LINE}"><g class="page">
{chr(10).join(drawn)}
</g></svg>
</svg>
"""


def _list_groups(recording: Recording) -> list[tuple[float, list[Text]]]:
    """When how many lines appear; a line counts once it is whole."""
    groups: list[tuple[float, list[Text]]] = []
    rest = ""
    for at, text in recording.chunks:
        *whole, rest = (rest + text.replace("\r\n", "\n")).split("\n")
        lines = [
            part
            for line in map(Text.from_ansi, whole)
            for part in line.divide(range(recording.width, len(line.plain), recording.width))
        ]
        assert not any("\x1b" in line.plain or "\r" in line.plain for line in lines), "the cursor moves"
        if lines:
            groups.append((at, lines))
    return groups


def _draw_line(line: Text, number: int) -> str:
    spans = [
        f'<tspan x="{start * CELL:.1f}"{_draw_style(style)}>{escape(line.plain[start:end])}</tspan>'
        for start, end, style in _list_spans(line)
        if line.plain[start:end].strip()
    ]
    return f'<text y="{(number + 0.8) * LINE:.0f}">{"".join(spans)}</text>' if spans else ""


def _list_spans(line: Text) -> list[tuple[int, int, Style]]:
    """Pieces of one style each, without gaps."""
    cuts = sorted({0, len(line.plain), *(cut for span in line.spans for cut in (span.start, span.end))})
    return [
        (start, end, Style.combine([Style(), *[span.style for span in line.spans if span.start <= start < span.end and isinstance(span.style, Style)]]))
        for start, end in pairwise(cuts)
    ]  # fmt: skip


def _draw_style(style: Style) -> str:
    colour = style.color or Color.default()
    fill = "" if colour.is_default else f' fill="{colour.get_truecolor(THEME).hex}"'
    bold = ' font-weight="bold"' if style.bold else ""
    dim = ' opacity=".6"' if style.dim else ""
    return fill + bold + dim
