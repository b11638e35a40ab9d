# SPDX-License-Identifier: Apache-2.0
"""Short form of ``make quality``: what the page on quality states holds on a few fleets, and its tables are
those of the program.
"""

from pathlib import Path

import pytest

from tests.quality.measures import (
    count_evicting_fleets,
    count_losing_fleets,
    count_proven_fleets,
    count_short_fleets,
    count_true_statements,
    measure_shortfalls,
)
from tests.quality.tables import Table, build_tables, format_row

PAGE = Path(__file__).parents[2] / "docs/concepts/quality.md"


def test_nothing_that_fits_is_left_out() -> None:
    assert count_short_fleets(5, 20, range(6)) == 0
    assert (
        count_short_fleets(10, 50, (29, 43)) == 0
    )  # of which the first tasks need the work that others leave


def test_a_larger_edge_unplaces_nothing() -> None:
    assert count_losing_fleets(5, 20, range(8), 0.7) == 0


def test_no_newcomer_evicts_by_its_name() -> None:
    assert count_evicting_fleets(5, 20, range(5), 0.8) == 0


def test_a_rebalanced_plan_is_close_to_the_proven_best() -> None:
    found = measure_shortfalls(5, 20, (3, 4), 0.7, 60.0)
    assert all(each.proven for each in found["plan --optimal"])
    assert all(each.below < 0.02 for each in found["plan --rebalance"])
    assert max(each.below for each in found["plan"]) > 0.02


def test_the_first_two_levels_are_proven() -> None:
    assert count_proven_fleets(4, 14, range(2), 0.8, 4, 30.0) == 2


def test_each_statement_of_an_explanation_is_true_of_the_whole_plan() -> None:
    """Of a fleet in which the task moves to and fro on the way to one of its crossings."""
    total, true = count_true_statements([4], ["task8"])
    assert total == true > 5


@pytest.mark.parametrize("table", build_tables(), ids=lambda table: table.heading)
def test_the_page_has_the_tables_of_the_program(table: Table) -> None:
    section = PAGE.read_text().split(f"## {table.heading}\n")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("|")]
    assert rows[0] == format_row(table.columns)
    starts = [format_row(labels)[:-1] for labels in table.labels]
    assert [row[: len(start)] for row, start in zip(rows[2:], starts, strict=True)] == starts
