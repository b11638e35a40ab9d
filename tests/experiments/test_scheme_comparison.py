"""Comparisons of schemes by pairs, and the sentence that answers them."""

from collections.abc import Mapping
from dataclasses import replace
from math import exp, log, sqrt

import pytest

from edgectl.experiments.model.comparison import Interval, SchemeComparison, SchemeResult
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.scheme_comparison import compare_schemes, find_primary_comparison
from edgectl.experiments.views.answer import describe_answer
from edgectl.model.policy import Policy, PolicyName


def result(
    name: str, *values: float | None, metric: str = "latency", **metrics: Mapping[int, float]
) -> SchemeResult:
    """A scheme with one value per repetition; None: the trial has failed or has not run."""
    policy = Policy(name=PolicyName(name.split()[0]))
    return SchemeResult(
        scheme=Scheme(name=name, policy=policy), runs=len(values), unfinished=0, unplaced=0, estimates={},
        values={metric: {number: value for number, value in enumerate(values, 1) if value is not None}, **metrics},
    )  # fmt: skip


def test_a_pair_worked_by_hand() -> None:
    """Differences -1, -2, -3 (mean -2, error 1/sqrt 3, t = 4.303); ratios .9, .8, .7."""
    found = compare_schemes([result("static", 10.0, 10.0, 10.0), result("utility all", 9.0, 8.0, 7.0)])[0]
    assert (found.scheme, found.base, found.pairs, found.missing) == ("utility all", "static", 3, 0)
    assert found.difference is not None
    assert found.difference.mean == pytest.approx(-2.0)
    assert found.difference.low == pytest.approx(-2.0 - 4.3027 / sqrt(3), abs=1e-3)
    assert found.ratio is not None
    assert found.ratio.mean == pytest.approx((0.9 * 0.8 * 0.7) ** (1 / 3))
    logs = [log(ratio) for ratio in (0.9, 0.8, 0.7)]
    mean = sum(logs) / 3
    error = sqrt(sum((value - mean) ** 2 for value in logs) / 2 / 3)
    assert found.ratio.high == pytest.approx(exp(mean + 4.3027 * error), abs=1e-4)
    assert found.p == found.p_holm, "one comparison needs no correction"


def test_every_utility_scheme_is_compared_with_every_other_and_holm_counts_them() -> None:
    results = [
        result("utility cpu", 9.0, 8.0, 7.1), result("static", 10.0, 10.5, 10.0), result("local", 12.0, 14.0, 13.0),
        result("utility all", 7.0, 8.0, 7.5),
    ]  # fmt: skip
    found = compare_schemes(results, 0.05)
    assert [(each.scheme, each.base) for each in found] == [
        ("utility cpu", "static"), ("utility cpu", "local"), ("utility all", "static"), ("utility all", "local"),
    ]  # fmt: skip
    least = min(found, key=lambda each: each.p or 1.0)
    assert least.p_holm == pytest.approx(4 * (least.p or 0.0))
    assert all(each.bound == 0.05 and each.equal_p is not None for each in found)
    primary = find_primary_comparison(found)
    assert primary is not None
    assert (primary.scheme, primary.base) == ("utility all", "static")


def test_without_both_kinds_the_first_scheme_is_the_base() -> None:
    found = compare_schemes(
        [result("pack", 1.0, 2.0), result("random", 2.0, 3.0), result("static", 3.0, 3.0)]
    )
    assert [(each.scheme, each.base) for each in found] == [("random", "pack"), ("static", "pack")]
    assert compare_schemes([result("local", 1.0)]) == ()
    assert find_primary_comparison(()) is None


def test_failed_trials_leave_their_pair_out() -> None:
    found = compare_schemes(
        [result("static", 10.0, None, 10.0, 11.0), result("utility all", 9.0, 8.0, None, 10.0)]
    )[0]
    assert (found.pairs, found.missing) == (2, 2)
    assert found.difference is not None
    assert found.difference.mean == pytest.approx(-1.0)
    none = compare_schemes([result("static", None, 10.0), result("utility all", 9.0, None)])[0]
    assert (none.pairs, none.missing, none.difference, none.ratio, none.p) == (0, 2, None, None, None)


def test_a_metric_with_zeros_has_differences_and_no_ratio() -> None:
    moves = {number: float(number % 2) for number in (1, 2, 3)}
    found = compare_schemes(
        [result("static", 9.0, 9.5, 9.0, handoffs=dict.fromkeys((1, 2, 3), 0.0)), result("utility all", 9.0, 9.0, 9.1, handoffs=moves)], 0.05
    )  # fmt: skip
    handoffs = found[1]
    assert (handoffs.metric, handoffs.ratio, handoffs.equal_p) == ("handoffs", None, None)
    assert handoffs.difference is not None
    assert handoffs.difference.mean == pytest.approx(2 / 3)
    # mean 2/3, deviation 1/sqrt 3, error 1/3: t = 2 with 2 degrees of freedom
    assert handoffs.p == pytest.approx(1 - 2 / sqrt(6))


def test_metrics_of_hosts_are_compared_on_the_same_hosts_only() -> None:
    cpu = {1: 50.0, 2: 60.0}
    robots = result("local", 9.0, 9.5, cpu=cpu)
    edges = replace(result("utility all", 9.0, 9.1, cpu=cpu), hosts=("zulu", "alpha"))
    others = replace(result("static", 9.0, 9.2, cpu=cpu), hosts=("zulu", "alpha"))
    found = compare_schemes([robots, others, edges])
    assert [(each.metric, each.base) for each in found] == [
        ("latency", "local"),
        ("latency", "static"),
        ("cpu", "static"),
    ]


FOUND = SchemeComparison(
    metric="latency", scheme="utility all", base="static", pairs=10, missing=0, difference=Interval(mean=-5.0, low=-8.0, high=-2.0),
    ratio=Interval(mean=0.84, low=0.73, high=0.96), p=0.005, p_holm=0.02, effect=-1.1,
)  # fmt: skip
BOUND = replace(FOUND, bound=0.05, equal_p=0.9, equal_p_holm=0.9)
EVEN = replace(BOUND, ratio=Interval(mean=1.01, low=0.985, high=1.03), p=0.3, p_holm=0.31)


@pytest.mark.parametrize(
    ("comparison", "sentence"),
    [
        (FOUND, "utility all finished the mission 16 % sooner than static (95 % interval 4.0 to 27 %, n = 10 pairs, p = 0.02 after Holm)."),
        (
            replace(FOUND, ratio=Interval(mean=1.3, low=1.12, high=1.5), p_holm=1e-5),
            "utility all finished the mission 30 % later than static (95 % interval 12 to 50 %, n = 10 pairs, p < 0.001 after Holm).",
        ),
        (
            replace(FOUND, ratio=Interval(mean=0.98, low=0.91, high=1.055), p_holm=0.4),
            ("No difference between utility all and static could be shown: utility all finished the mission 2.0 % sooner "
            "(95 % interval 9.0 % sooner to 5.5 % later, n = 10 pairs, p = 0.40 after Holm)."),
        ),
        (
            EVEN,
            ("No difference between utility all and static could be shown: utility all finished the mission 1.0 % later "
            "(95 % interval 1.5 % sooner to 3.0 % later, n = 10 pairs, p = 0.31 after Holm); they are not shown equal within 5 % either."),
        ),
        (
            replace(EVEN, equal_p_holm=0.002),
            ("utility all and static are equal within 5 % in the time of the mission (ratio 1.010, 95 % interval 0.985 to 1.030, "
            "n = 10 pairs, p = 0.002 of equivalence)."),
        ),
        (
            replace(EVEN, ratio=Interval(mean=0.98, low=0.97, high=0.99), p_holm=0.01, equal_p_holm=0.001),
            ("utility all finished the mission 2.0 % sooner than static (95 % interval 1.0 to 3.0 %, n = 10 pairs, p = 0.01 after Holm). "
            "The difference is within 5 %, the stated bound of equality."),
        ),
        (
            replace(FOUND, pairs=1, ratio=Interval(mean=0.84), difference=Interval(mean=-5.0), p=None, p_holm=None, effect=None),
            "One pair shows no difference: utility all took 0.84 of the time of static; run more repetitions.",
        ),
        (
            replace(FOUND, difference=Interval(mean=0.0, low=0.0, high=0.0), ratio=Interval(mean=1.0, low=1.0, high=1.0), p=None, p_holm=None),
            "utility all and static finished the mission at the same time in each of 10 pairs.",
        ),
        (
            replace(BOUND, ratio=Interval(mean=0.98, low=0.98, high=0.98), p=None, p_holm=None, equal_p_holm=0.0),
            ("utility all finished the mission 2.0 % sooner than static, by the same share in each of 10 pairs: "
            "without spread there is no interval. That is within 5 %."),
        ),
        (
            replace(FOUND, pairs=0, missing=3, difference=None, ratio=None, p=None, p_holm=None),
            "No trials of utility all and static form a pair yet, so nothing is compared.",
        ),
        (None, "There is one scheme only, so nothing is compared."),
    ],
)  # fmt: skip
def test_the_answer(comparison: SchemeComparison | None, sentence: str) -> None:
    assert describe_answer(comparison) == sentence


def test_the_answer_says_what_is_left_out() -> None:
    assert describe_answer(replace(FOUND, missing=1)).endswith(
        " Left out: 1 repetition with a trial of one scheme only."
    )
    assert describe_answer(replace(FOUND, missing=2)).endswith(
        " Left out: 2 repetitions with a trial of one scheme only."
    )
