"""Statistics of pairs against worked examples of textbooks."""

from collections.abc import Sequence
from itertools import pairwise
from math import log, sqrt

import pytest
import scipy.stats  # type: ignore[import-untyped]
from hypothesis import given
from hypothesis import strategies as st

from edgectl.experiments.model.comparison import Interval
from edgectl.experiments.paired_tests import (
    SampleSummary,
    adjust_by_holm,
    compute_effect_size,
    compute_equivalence_p,
    compute_paired_p,
    compute_welch_p,
    estimate_mean_interval,
    match_pairs,
)

# Student (1908): hours of sleep gained by ten patients under two drugs.
DRUG_1 = (0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0)
DRUG_2 = (1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4)
DIFFERENCES = [one - other for one, other in zip(DRUG_1, DRUG_2, strict=True)]


def test_the_paired_test_of_student() -> None:
    """T = -4.0621 with 9 degrees of freedom, p = .002833; mean -1.58 with (-2.4599, -0.7001)."""
    assert compute_paired_p(DIFFERENCES) == pytest.approx(0.002833, abs=5e-7)
    found = estimate_mean_interval(DIFFERENCES)
    assert found.mean == pytest.approx(-1.58)
    assert found.low == pytest.approx(-2.4599, abs=5e-5)
    assert found.high == pytest.approx(-0.7001, abs=5e-5)


def test_the_same_sleep_as_two_independent_samples() -> None:
    """Welch: t = -1.8608 with 17.776 degrees of freedom, p = .07939."""
    samples = [SampleSummary(0.75, 1.789010, 10), SampleSummary(2.33, 2.002249, 10)]
    assert compute_welch_p(*samples) == pytest.approx(0.07939, abs=5e-6)


def test_the_effect_of_the_sleep() -> None:
    """-1.58 / 1.2300 = -1.2846; times 1 - 3 / 35 for ten pairs."""
    assert compute_effect_size(DIFFERENCES) == pytest.approx(-1.2846 * (1 - 3 / 35), abs=1e-4)


def test_holm_worked_by_hand() -> None:
    """Sorted .005, .01, .03, .04: times 4, 3, 2, 1 is .02, .03, .06, .04; the last is raised to .06."""
    assert adjust_by_holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert adjust_by_holm([None, 0.01, None, 0.9]) == [None, 0.02, None, 0.9]
    assert adjust_by_holm([0.8, 0.9]) == [1.0, 1.0]
    assert adjust_by_holm([]) == []


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8))
def test_holm_keeps_the_order_and_lowers_nothing(p_values: list[float]) -> None:
    adjusted = [p for p in adjust_by_holm(p_values) if p is not None]
    assert all(raw <= p <= 1.0 for raw, p in zip(p_values, adjusted, strict=True))
    ranked = [p for _, p in sorted(zip(p_values, adjusted, strict=True))]
    assert all(one <= other for one, other in pairwise(ranked))


def test_equivalence_worked_by_hand() -> None:
    """Logarithms 0, .01, .02, .01 (mean .01, error .00408): t = (.04879 - .01) / .00408 = 9.50 at 3."""
    logs = [0.0, 0.01, 0.02, 0.01]
    error = sqrt(2 / 3 * 1e-4) / 2
    expected = float(scipy.stats.t.sf((log(1.05) - 0.01) / error, 3))
    assert compute_equivalence_p(logs, 0.05) == pytest.approx(expected, rel=1e-7)
    assert expected == pytest.approx(0.001236, abs=1e-6)
    # a bound below the mean is never shown: the wrong tail is above a half
    assert compute_equivalence_p(logs, 0.005) == pytest.approx(
        1 - float(scipy.stats.t.cdf((log(1.005) - 0.01) / error, 3))
    )


@given(
    st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=9).filter(
        lambda values: max(values) - min(values) > 1e-3
    ),
    st.floats(0.01, 0.3),
)
def test_equivalence_is_the_interval_within_the_bound(logs: list[float], bound: float) -> None:
    """P below .05 exactly where the 90 % interval lies within the bound (Schuirmann 1987)."""
    found = estimate_mean_interval(logs, 0.90)
    assert found.low is not None
    assert found.high is not None
    within = max(-found.low, found.high)
    p = compute_equivalence_p(logs, bound)
    assert p is not None
    if abs(within - log(1 + bound)) > 1e-9:
        assert (p < 0.05) == (within < log(1 + bound))


@given(
    st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=12).filter(
        lambda values: max(values) - min(values) > 1e-3
    )
)
def test_paired_p_is_that_of_scipy(differences: list[float]) -> None:
    expected = float(scipy.stats.ttest_1samp(differences, 0.0).pvalue)
    assert compute_paired_p(differences) == pytest.approx(expected, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("values", [[], [2.0], [2.0, 2.0, 2.0], [0.1 + 0.2, 0.3, 0.3]])
def test_without_spread_or_with_one_value_there_is_no_test(values: Sequence[float]) -> None:
    assert compute_paired_p(values) is None
    assert compute_effect_size(values) is None


def test_limits_of_few_values() -> None:
    assert estimate_mean_interval([3.0]) == Interval(mean=3.0)
    assert estimate_mean_interval([3.0, 3.0]) == Interval(mean=3.0)
    assert compute_effect_size([1.0, 2.0]) is None, "two pairs: the correction has no degrees of freedom left"
    assert (compute_equivalence_p([0.0], 0.05), compute_equivalence_p([0.0, 0.0], 0.05)) == (None, 0.0)
    assert compute_equivalence_p([0.1, 0.1], 0.05) == 1.0
    one = SampleSummary(1.0, 0.0, 5)
    assert compute_welch_p(one, one) is None
    assert compute_welch_p(one, SampleSummary(1.0, 1.0, 1)) is None


def test_pairs_have_the_same_repetition() -> None:
    found = match_pairs({3: 30.0, 1: 10.0, 2: 20.0}, {1: 1.0, 3: 3.0, 4: 4.0})
    assert found == ([(10.0, 1.0), (30.0, 3.0)], 2)
    assert match_pairs({}, {}) == ([], 0)
