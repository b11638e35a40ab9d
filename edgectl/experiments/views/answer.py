"""The answer of a comparison in one sentence, with its interval (ADR 131)."""

from edgectl.experiments.model.comparison import Interval, SchemeComparison
from edgectl.experiments.paired_tests import CONFIDENCE
from edgectl.experiments.views.comparison_table import describe_p

_ALPHA = 1.0 - CONFIDENCE


def describe_answer(comparison: SchemeComparison | None) -> str:
    """Which of two schemes finished the mission sooner, by how much and how certain that is.

    A difference needs p below 0.05 after Holm; equality needs a bound, and p of equivalence below 0.05. All
    else is "no difference could be shown".
    """
    if comparison is None:
        return "There is one scheme only, so nothing is compared."
    if comparison.ratio is None:
        return (
            f"No trials of {comparison.scheme} and {comparison.base} form a pair yet, so nothing is compared."
        )
    return _describe_ratio(comparison, comparison.ratio) + _describe_missing(comparison)


def _describe_ratio(comparison: SchemeComparison, ratio: Interval) -> str:
    scheme, base, pairs = comparison.scheme, comparison.base, comparison.pairs
    if pairs == 1:
        return (
            f"One pair shows no difference: {scheme} took {ratio.mean:.2f} of the time of {base}; "
            "run more repetitions."
        )
    p, equal_p = comparison.p_holm, comparison.equal_p_holm
    within = equal_p is not None and equal_p < _ALPHA
    bound = "" if comparison.bound is None else f"{100 * comparison.bound:g} %"
    if p is None:
        return _describe_without_spread(comparison, ratio) + (f" That is within {bound}." if within else "")
    interval = f"95 % interval {_format_gain_interval(ratio)}, n = {pairs} pairs, {describe_p(p)} after Holm"
    if p < _ALPHA:
        text = f"{scheme} finished the mission {_format_gain(ratio.mean)} than {base} ({interval})."
        return f"{text} The difference is within {bound}, the stated bound of equality." if within else text
    if within and equal_p is not None:
        return (
            f"{scheme} and {base} are equal within {bound} in the time of the mission "
            f"(ratio {ratio.mean:.3f}, 95 % interval {ratio.low:.3f} to {ratio.high:.3f}, n = {pairs} pairs, "
            f"{describe_p(equal_p)} of equivalence)."
        )
    text = f"No difference between {scheme} and {base} could be shown: {scheme} finished the mission"
    equal = f"; they are not shown equal within {bound} either" if bound else ""
    return f"{text} {_format_gain(ratio.mean)} ({interval}){equal}."


def _describe_without_spread(comparison: SchemeComparison, ratio: Interval) -> str:
    """Without spread there is no test: the model has no random part, or the schemes did the same."""
    scheme, base, pairs = comparison.scheme, comparison.base, comparison.pairs
    if comparison.difference is not None and abs(comparison.difference.mean) < 1e-9:
        return f"{scheme} and {base} finished the mission at the same time in each of {pairs} pairs."
    return (
        f"{scheme} finished the mission {_format_gain(ratio.mean)} than {base}, by the same share in each of "
        f"{pairs} pairs: without spread there is no interval."
    )


def _describe_missing(comparison: SchemeComparison) -> str:
    if not comparison.missing:
        return ""
    noun = "repetition" if comparison.missing == 1 else "repetitions"
    return f" Left out: {comparison.missing} {noun} with a trial of one scheme only."


def _format_gain(ratio: float) -> str:
    """``16 % sooner``, ``4.2 % later``."""
    return f"{_format_percent(abs(1 - ratio))} % {'later' if ratio > 1 else 'sooner'}"


def _format_gain_interval(ratio: Interval) -> str:
    """``4 to 27 %`` where both ends have the sign of the mean, else both ends in words."""
    if ratio.low is None or ratio.high is None:
        return "not known"
    ends = sorted((abs(1 - ratio.low), abs(1 - ratio.high)))
    if (ratio.low - 1) * (ratio.high - 1) > 0:
        return f"{_format_percent(ends[0])} to {_format_percent(ends[1])} %"
    return f"{_format_percent(1 - ratio.low)} % sooner to {_format_percent(ratio.high - 1)} % later"


def _format_percent(share: float) -> str:
    """In percent: two digits below 10."""
    percent = 100 * share
    return f"{percent:.0f}" if percent >= 9.95 else f"{percent:.1f}"
