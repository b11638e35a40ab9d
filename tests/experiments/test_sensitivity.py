# SPDX-License-Identifier: Apache-2.0
"""The page of sensitivity is made of its committed results."""

import re

import pytest

from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.files.sweep_results import list_missing
from edgectl.experiments.report.figure_style import get_scheme_colour
from tests.docs.evaluation import RUN as EVALUATED
from tests.experiments.sensitivity import (
    COLOURS,
    FIGURE,
    PAGE,
    draw_figure,
    format_cell,
    is_in_grid,
    load,
    render_table,
    replace_table,
)


def test_all_worlds_have_a_committed_result() -> None:
    sweep, results = load()
    assert list_missing(sweep.worlds, results) == [], "make sensitivity simulates them"


def test_the_table_is_that_of_the_results() -> None:
    page = PAGE.read_text()
    assert replace_table(page, render_table(*load())) == page, "make sensitivity writes it"


@pytest.mark.slow
def test_the_figure_shows_what_the_table_says() -> None:
    drawn = draw_figure(*load()).decode()
    sweep, results = load()
    grid = [results[world.digest] for world in sweep.worlds if is_in_grid(world)]
    assert all(each.runs == 20 for each in results.values())
    assert {len(each.latency) for result in results.values() for each in result.schemes.values()} == {20}
    for result in grid:
        gain = re.sub(r".* (\S+%) \[(\S+), (\S+)\]", r"\1 \2 .. \3", format_cell(result))
        assert all(f">{text}<" in FIGURE.read_text() for text in gain.split(" ", 1))
    for text in ("dynamic wins", "static is enough", "local is best or as good", "radio: shared"):
        assert text in drawn
        assert text in FIGURE.read_text()
    for figure in (drawn, FIGURE.read_text()):
        # 3.5 in: on a screen of 400 px a text of 6 pt is 9 px high.
        assert 'viewBox="0 0 252 ' in figure
        assert min(float(size) for size in re.findall(r"([0-9.]+)px", figure)) >= 6.0


def test_a_scheme_has_the_colour_that_it_has_in_the_figures_of_the_run() -> None:
    run = load_run(EVALUATED)
    assert {name: get_scheme_colour(run, name) for name in COLOURS} == COLOURS
