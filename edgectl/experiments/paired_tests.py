"""Statistics of paired values: intervals, tests, effect size, equivalence, Holm (ADR 131, pure)."""

from collections.abc import Mapping, Sequence
from math import inf, log1p, sqrt
from statistics import fmean, stdev
from typing import NamedTuple

from edgectl.experiments.model.comparison import Interval
from edgectl.experiments.student import compute_t_quantile, compute_t_tail

CONFIDENCE = 0.95
# A spread below this share of the greatest value is rounding.
_ROUNDING = 1e-12


class MatchedPairs(NamedTuple):
    """Values of two schemes by what they share, and how many have a value of one scheme only."""

    pairs: Sequence[tuple[float, float]]
    missing: int


def match_pairs(values: Mapping[int, float], others: Mapping[int, float]) -> MatchedPairs:
    """The values of the same repetition (or run, which is the same seed), in its order.

    A repetition without a value of either is in neither.
    """
    both = sorted(values.keys() & others.keys())
    return MatchedPairs(
        [(values[key], others[key]) for key in both], len(values.keys() | others.keys()) - len(both)
    )


def estimate_mean_interval(values: Sequence[float], confidence: float = CONFIDENCE) -> Interval:
    """The mean of at least one value with its t interval; without spread (a single value) there is none."""
    mean = fmean(values)
    if not has_spread(values):
        return Interval(mean=mean)
    half = compute_t_quantile((1 + confidence) / 2, len(values) - 1) * _compute_standard_error(values)
    return Interval(mean=mean, low=mean - half, high=mean + half)


def compute_paired_p(values: Sequence[float]) -> float | None:
    """Two-sided p of Student's test that the mean is 0: of differences, the paired test.

    None where nothing can be tested: fewer than two values, or values without spread.
    """
    if not has_spread(values):
        return None
    return 2.0 * compute_t_tail(abs(fmean(values)) / _compute_standard_error(values), len(values) - 1)


def compute_equivalence_p(log_ratios: Sequence[float], bound: float) -> float | None:
    """P of two one-sided tests (TOST): the mean ratio lies between 1 / (1 + bound) and 1 + bound.

    ``bound`` is a share above 0. Values without spread: 0 where the ratio is within the bound, else 1; None
    with fewer than two.
    """
    limit = log1p(bound)
    if len(log_ratios) < 2:
        return None
    mean = fmean(log_ratios)
    if not has_spread(log_ratios):
        return 0.0 if abs(mean) < limit else 1.0
    error = _compute_standard_error(log_ratios)
    return compute_t_tail((limit - abs(mean)) / error, len(log_ratios) - 1)


def compute_effect_size(differences: Sequence[float]) -> float | None:
    """Hedges' g of paired values: mean over standard deviation of the differences, corrected for few pairs.

    d_z x (1 - 3 / (4 (n - 1) - 1)). None where there is no spread, or with fewer than three pairs.
    """
    if len(differences) < 3 or not has_spread(differences):
        return None
    correction = 1 - 3 / (4 * (len(differences) - 1) - 1)
    return correction * fmean(differences) / stdev(differences)


def adjust_by_holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Each p after the step-down procedure of Holm (1979) over those that are known; at most 1."""
    known = sorted((p, place) for place, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    least = 0.0
    for rank, (p, place) in enumerate(known):
        least = max(least, min(1.0, (len(known) - rank) * p))
        adjusted[place] = least
    return adjusted


class SampleSummary(NamedTuple):
    """Mean, standard deviation (n - 1) and number of independent values."""

    mean: float
    std: float
    size: int


def compute_welch_p(one: SampleSummary, other: SampleSummary) -> float | None:
    """Two-sided p that two independent samples have the same mean, whatever their spreads (Welch 1947).

    None with fewer than two values in one, or without any spread.
    """
    if min(one.size, other.size) < 2:
        return None
    shares = [sample.std**2 / sample.size for sample in (one, other)]
    if sum(shares) == 0:
        return None
    freedom = sum(shares) ** 2 / sum(
        share**2 / (sample.size - 1) for share, sample in zip(shares, (one, other), strict=True)
    )
    return 2.0 * compute_t_tail(abs(one.mean - other.mean) / sqrt(sum(shares)), freedom)


def has_spread(values: Sequence[float]) -> bool:
    """Whether at least two of the values differ by more than rounding."""
    greatest = max(map(abs, values), default=0.0)
    return len(values) > 1 and max(values) - min(values) > _ROUNDING * max(1.0, greatest) and greatest < inf


def _compute_standard_error(values: Sequence[float]) -> float:
    return stdev(values) / sqrt(len(values))
