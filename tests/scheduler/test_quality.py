"""Short form of ``make quality``: what the page on quality states holds on a few fleets."""

from tests.quality.measures import (
    count_losing_fleets,
    count_proven_fleets,
    count_short_fleets,
    measure_shortfalls,
)


def test_nothing_that_fits_is_left_out() -> None:
    assert count_short_fleets(5, 20, range(6)) == 0


def test_a_larger_edge_unplaces_nothing() -> None:
    assert count_losing_fleets(5, 20, range(8), 0.7) == 0


def test_a_rebalanced_plan_is_close_to_the_proven_best() -> None:
    plain, rebalanced, gap, proven = measure_shortfalls(5, 20, (3, 4), 0.7, 60.0)
    assert plain.mean > 0.01
    assert rebalanced.most < 0.02
    assert gap < 1e-5
    assert proven == 2


def test_the_first_two_levels_are_proven() -> None:
    assert count_proven_fleets(4, 14, range(2), 0.8, 4, 30.0) == 2
