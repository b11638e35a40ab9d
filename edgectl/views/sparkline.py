# SPDX-License-Identifier: Apache-2.0
"""Bars and sparklines from block glyphs, or from ASCII. Pure: numbers in, text out."""

import math
from collections.abc import Sequence

SPARKLINE_SAMPLES = 60
_BAR_EIGHTHS = " ▏▎▍▌▋▊▉█"
_LEVELS = "▁▂▃▄▅▆▇█"
_ASCII_LEVELS = "_.-:=+*#"


def render_bar(share: float, width: int, *, unicode: bool) -> str:
    """``share`` (clamped to 0..1) as a bar of ``width`` columns, to an eighth of one, in ASCII whole ones.

    Anything above 0 shows, and only a share of 1 fills the bar.
    """
    parts = 8 if unicode else 1
    filled = _count_filled_steps(share, width * parts)
    if not unicode:
        return ("#" * filled).ljust(width, ".")
    whole, rest = divmod(filled, parts)
    return ("█" * whole + (_BAR_EIGHTHS[rest] if rest else "")).ljust(width)


def _count_filled_steps(share: float, steps: int) -> int:
    """How many of ``steps`` are filled: 0 and all of them only where the share is 0 (or none) and 1."""
    if math.isnan(share) or share <= 0:
        return 0
    return steps if share >= 1 else min(max(round(share * steps), 1), steps - 1)


def render_sparkline(
    values: Sequence[float | None], top: float, width: int = SPARKLINE_SAMPLES, *, unicode: bool
) -> str:
    """The newest ``width`` of ``values`` (oldest first), one glyph each.

    Eight equal steps up to ``top``; a blank where there is no value.
    """
    levels = _LEVELS if unicode else _ASCII_LEVELS
    return "".join(_get_level_glyph(value, top, levels) for value in values[-width:]) if width > 0 else ""


def _get_level_glyph(value: float | None, top: float, levels: str) -> str:
    if value is None or math.isnan(value):
        return " "
    share = value / top if top > 0 else 0.0
    return levels[min(max(int(min(share, 1.0) * len(levels)), 0), len(levels) - 1)]
