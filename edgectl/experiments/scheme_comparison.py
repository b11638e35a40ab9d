"""Comparison of schemes by pairs of runs: differences, ratios, tests and equivalence (ADR 131)."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import exp, log

from edgectl.experiments.model.comparison import Interval, SchemeComparison, SchemeResult
from edgectl.experiments.paired_tests import (
    adjust_by_holm,
    compute_effect_size,
    compute_equivalence_p,
    compute_paired_p,
    estimate_mean_interval,
    match_pairs,
)
from edgectl.experiments.scheme_results import HOST_METRICS
from edgectl.model.policy import PolicyName

# The metric of the mission as a whole, which answers whether a scheme is better.
MISSION_TIME = "latency"
# The scheme of policy utility that stands for it where there are several, and what it is held against.
_PRIMARY_SCHEME = "utility all"
_PRIMARY_BASES = (PolicyName.STATIC, PolicyName.LOCAL)


def compare_schemes(
    results: Sequence[SchemeResult], bound: float | None = None
) -> tuple[SchemeComparison, ...]:
    """Every scheme of policy utility against every other scheme, in each metric of which both have values.

    Without schemes of both kinds: every scheme against the first. ``bound``: of equivalence, a share. Holm's
    correction is over the comparisons of one metric.
    """
    pairs = list(_list_compared_pairs(results))
    metrics = dict.fromkeys([MISSION_TIME, *(metric for result in results for metric in result.values)])
    found: list[SchemeComparison] = []
    for metric in metrics:
        family = [
            _compare_pair(result, base, metric, bound)
            for result, base in pairs
            if metric == MISSION_TIME or _is_comparable(result, base, metric)
        ]
        found += _adjust_family(family)
    return tuple(found)


def _is_comparable(result: SchemeResult, base: SchemeResult, metric: str) -> bool:
    """Whether both have values, and of the same hosts where the metric is one of hosts."""
    of_hosts = metric in (*HOST_METRICS, "rate")
    known = result.values.get(metric) and base.values.get(metric)
    return bool(known) and (not of_hosts or result.hosts == base.hosts)


def find_primary_comparison(comparisons: Sequence[SchemeComparison]) -> SchemeComparison | None:
    """The comparison that answers the question of the experiment, chosen by names before any result.

    Of mission times, utility all (else the first scheme) against static (else local, else the first).
    """
    missions = [each for each in comparisons if each.metric == MISSION_TIME]
    schemes = [each.scheme for each in missions]
    scheme = _PRIMARY_SCHEME if _PRIMARY_SCHEME in schemes else next(iter(schemes), None)
    own = [each for each in missions if each.scheme == scheme]
    for base in _PRIMARY_BASES:
        for each in own:
            if each.base == base.value:
                return each
    return next(iter(own), None)


def _list_compared_pairs(
    results: Sequence[SchemeResult],
) -> Iterator[tuple[SchemeResult, SchemeResult]]:
    utility = [result for result in results if result.scheme.policy.name is PolicyName.UTILITY]
    others = [result for result in results if result.scheme.policy.name is not PolicyName.UTILITY]
    if not utility or not others:
        utility, others = list(results[1:]), list(results[:1])
    yield from ((result, base) for result in utility for base in others)


def _compare_pair(
    result: SchemeResult, base: SchemeResult, metric: str, bound: float | None
) -> SchemeComparison:
    pairs, missing = match_pairs(result.values.get(metric, {}), base.values.get(metric, {}))
    empty = SchemeComparison(
        metric=metric, scheme=result.scheme.name, base=base.scheme.name, pairs=len(pairs), missing=missing,
        bound=bound,
    )  # fmt: skip
    if not pairs:
        return empty
    differences = [value - other for value, other in pairs]
    positive = all(value > 0 and other > 0 for value, other in pairs)
    log_ratios = [log(value / other) for value, other in pairs] if positive else None
    tested = differences if log_ratios is None else log_ratios
    return replace(
        empty,
        difference=estimate_mean_interval(differences),
        ratio=None if log_ratios is None else _exponentiate(estimate_mean_interval(log_ratios)),
        p=compute_paired_p(tested),
        effect=compute_effect_size(tested),
        equal_p=None if log_ratios is None or bound is None else compute_equivalence_p(log_ratios, bound),
    )


def _exponentiate(interval: Interval) -> Interval:
    """The interval of a geometric mean from that of the logarithms."""
    low, high = interval.low, interval.high
    return Interval(
        mean=exp(interval.mean),
        low=None if low is None else exp(low),
        high=None if high is None else exp(high),
    )


def _adjust_family(family: Sequence[SchemeComparison]) -> Iterator[SchemeComparison]:
    """The comparisons with Holm's correction; claims of difference and of equality are families apart."""
    adjusted = adjust_by_holm([each.p for each in family])
    equal = adjust_by_holm([each.equal_p for each in family])
    for each, p, equal_p in zip(family, adjusted, equal, strict=True):
        yield replace(each, p_holm=p, equal_p_holm=equal_p)
