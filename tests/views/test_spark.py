# SPDX-License-Identifier: Apache-2.0
"""Bars and sparklines, worked by hand."""

import math

import pytest

from edgectl.views.sparkline import render_bar, render_sparkline


@pytest.mark.parametrize(
    ("share", "drawn"),
    [
        (0.0, "        "),
        (0.001, "▏       "),  # anything shows
        (0.125, "█       "),
        (0.5, "████    "),
        (0.64, "█████▏  "),  # 0.64 x 64 eighths = 40.96, so 41: five and one eighth
        (0.97, "███████▊"),  # 62.08, so 62: seven and six eighths
        (0.999, "███████▉"),  # only 1 fills it
        (1.0, "████████"),
        (2.5, "████████"),
        (-1.0, "        "),
        (math.nan, "        "),
    ],
)
def test_a_bar_counts_eighths(share: float, drawn: str) -> None:
    assert render_bar(share, 8, unicode=True) == drawn


@pytest.mark.parametrize(
    ("share", "drawn"),
    [
        (0.0, "........"),
        (0.01, "#......."),
        (0.5, "####...."),
        (0.64, "#####..."),
        (0.99, "#######."),
        (1.0, "########"),
    ],
)
def test_a_bar_in_ascii_counts_columns(share: float, drawn: str) -> None:
    assert render_bar(share, 8, unicode=False) == drawn


def test_a_sparkline_has_eight_steps() -> None:
    steps = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]
    assert render_sparkline(steps, 4.0, unicode=True) == "▁▂▃▄▅▆▇██"
    assert render_sparkline(steps, 4.0, unicode=False) == "_.-:=+*##"


def test_a_sparkline_keeps_the_newest_and_shows_gaps() -> None:
    assert render_sparkline([4.0, 4.0, 0.0, None, 9.0, -1.0], 4.0, 4, unicode=True) == "▁ █▁"
    assert render_sparkline([math.nan, math.inf, 1.0], 0.0, unicode=True) == " ▁▁", (
        "without a scale everything is low"
    )
    assert render_sparkline([1.0] * 100, 1.0, unicode=True) == "█" * 60
    assert render_sparkline([1.0], 1.0, 0, unicode=True) == ""
    assert render_sparkline([], 1.0, unicode=True) == ""
