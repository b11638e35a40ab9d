"""Student's t distribution against printed tables, closed forms and SciPy."""

from math import atan, inf, pi, sqrt

import pytest
import scipy.stats  # type: ignore[import-untyped]
from hypothesis import given
from hypothesis import strategies as st

from edgectl.experiments.student import compute_t_quantile, compute_t_tail

# Two-sided 95 % and 99 % of the usual printed tables.
TABLE = [
    (0.975, 1, 12.706), (0.975, 2, 4.303), (0.975, 4, 2.776), (0.975, 9, 2.262), (0.975, 19, 2.093), (0.975, 30, 2.042),
    (0.975, 120, 1.980), (0.995, 1, 63.657), (0.995, 9, 3.250), (0.995, 30, 2.750), (0.95, 5, 2.015), (0.90, 10, 1.372),
]  # fmt: skip


@pytest.mark.parametrize(("probability", "freedom", "expected"), TABLE)
def test_quantiles_of_printed_tables(probability: float, freedom: float, expected: float) -> None:
    assert compute_t_quantile(probability, freedom) == pytest.approx(expected, abs=6e-4)


@pytest.mark.parametrize("t", [0.0, 0.1, 1.0, 2.5, 40.0, 1e6])
def test_tails_with_a_closed_form(t: float) -> None:
    assert compute_t_tail(t, 1) == pytest.approx(0.5 - atan(t) / pi, rel=1e-8, abs=1e-13)
    assert compute_t_tail(t, 2) == pytest.approx(1 / (sqrt(2 + t * t) * (sqrt(2 + t * t) + t)), rel=1e-8)


@given(st.floats(-60.0, 60.0), st.floats(0.5, 1e4))
def test_tails_are_those_of_scipy(t: float, freedom: float) -> None:
    assert compute_t_tail(t, freedom) == pytest.approx(
        float(scipy.stats.t.sf(t, freedom)), rel=1e-7, abs=1e-300
    )


@given(st.floats(1e-6, 1 - 1e-6), st.floats(0.8, 1e4))
def test_a_quantile_has_its_probability(probability: float, freedom: float) -> None:
    t = compute_t_quantile(probability, freedom)
    assert 1 - compute_t_tail(t, freedom) == pytest.approx(probability, rel=1e-9)


def test_limits() -> None:
    assert (compute_t_tail(0.0, 3), compute_t_tail(inf, 3), compute_t_tail(-inf, 3)) == (0.5, 0.0, 1.0)
    assert compute_t_quantile(0.5, 3) == pytest.approx(0.0, abs=1e-9)
    for arguments in ((0.0, 3), (1.0, 3), (0.5, 0)):
        with pytest.raises(ValueError, match="must be"):
            compute_t_quantile(*arguments)
