"""Comparisons of schemes as a table and as documents."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from edgectl.experiments.model.comparison import Interval, SchemeComparison
from edgectl.experiments.scheme_comparison import MISSION_TIME
from edgectl.experiments.views.scheme_table import MetricColumn, render_scheme_table
from edgectl.formats.document import Document, encode_number, encode_optional
from edgectl.views.text import Cell, RenderOptions, Row

_LEAST_P = 0.001


def build_comparison_rows(
    comparisons: Sequence[SchemeComparison], columns: Mapping[str, MetricColumn]
) -> list[Row]:
    """The heading and a row per comparison, of the metrics in ``columns``; empty without any.

    The column of a metric formats its differences. The number of pairs is left out where it is the same.
    """
    shown = [each for each in comparisons if each.metric in columns and each.pairs]
    if not shown:
        return []
    several = {each.metric for each in shown} != {MISSION_TIME}
    counted = len({each.pairs for each in shown}) > 1
    bounded = any(each.bound is not None for each in shown)
    unit = "" if several else f" {get_unit(columns[MISSION_TIME])}"
    heading = ["METRIC"] * several + ["PAIRS"] * counted
    last = ["EQUAL P"] * bounded
    rows: list[Row] = [("SCHEME", "AGAINST", *heading, f"DIFFERENCE{unit}", "RATIO", "P", "EFFECT", *last)]
    for each in shown:
        column = columns[each.metric]
        cells = [column.heading] * several + [str(each.pairs)] * counted
        cells.append(_format_interval(each.difference, column.format_number))
        cells.append(_format_interval(each.ratio, "{:.2f}".format))
        cells += [format_p(each.p_holm), "-" if each.effect is None else f"{each.effect:.1f}"]
        cells += [format_p(each.equal_p_holm)] * bounded
        rows.append((Cell(each.scheme, "name"), each.base, *cells))
    return rows


def render_comparison_table(
    comparisons: Sequence[SchemeComparison], columns: Sequence[MetricColumn], look: RenderOptions
) -> str:
    """The table of the metrics in ``columns``, ended by an empty line; nothing without comparisons."""
    rows = build_comparison_rows(comparisons, {column.name: column for column in columns})
    return f"{render_scheme_table(rows, look)}\n" if rows else ""


def get_unit(column: MetricColumn) -> str:
    """``s`` of ``LATENCY s``."""
    return column.heading.split()[-1]


def describe_comparisons(comparisons: Sequence[SchemeComparison]) -> Iterator[str]:
    """The notes below the table."""
    missions = [each for each in comparisons if each.metric == MISSION_TIME and each.pairs]
    if not missions:
        return
    least, most = (choose(each.pairs for each in missions) for choose in (min, max))
    bound, pairs = missions[0].bound, str(least) if least == most else f"{least} to {most}"
    yield (
        f"Compared by {pairs} pair{'' if most == 1 else 's'} of the same repetition: mean difference and "
        "geometric mean ratio with 95 % intervals (Student's t); P: paired t test of the logarithms, after "
        f"Holm over {len(missions)} comparison{'' if len(missions) == 1 else 's'} a metric; "
        "EFFECT: Hedges' g of the same."
    )
    if bound is not None:
        yield f"EQUAL P: two one-sided tests that the ratio is within {100 * bound:g} %, after Holm."


def describe_p(p: float) -> str:
    """``p = 0.02``, ``p < 0.001``."""
    text = format_p(p)
    return f"p < {text[1:]}" if text.startswith("<") else f"p = {text}"


def format_p(p: float | None) -> str:
    """Two digits, from 0.001 on."""
    if p is None:
        return "-"
    if p < _LEAST_P:
        return f"<{_LEAST_P}"
    return f"{p:.2f}" if p >= 0.0995 else f"{p:.2g}"


def _format_interval(interval: Interval | None, format_number: Callable[[float], str]) -> str:
    """The mean, and its limits in brackets if there are any."""
    if interval is None:
        return "-"
    mean, *limits = (
        _drop_sign_of_zero(format_number(value))
        for value in (interval.mean, interval.low, interval.high)
        if value is not None
    )
    return f"{mean} [{', '.join(limits)}]" if limits else mean


def _drop_sign_of_zero(text: str) -> str:
    """``0.0`` for ``-0.0``."""
    return text.removeprefix("-") if not text.strip("-0.") else text


def encode_comparison(comparison: SchemeComparison) -> Document:
    """A comparison as JSON types; differences in the unit of the metric."""
    return {
        "metric": comparison.metric,
        "scheme": comparison.scheme,
        "base": comparison.base,
        "pair_count": comparison.pairs,
        "missing_pair_count": comparison.missing,
        "difference": _encode_interval(comparison.difference),
        "ratio": _encode_interval(comparison.ratio),
        "p": encode_optional(comparison.p),
        "p_holm": encode_optional(comparison.p_holm),
        "effect": encode_optional(comparison.effect),
        "bound": encode_optional(comparison.bound),
        "equal_p": encode_optional(comparison.equal_p),
        "equal_p_holm": encode_optional(comparison.equal_p_holm),
    }


def _encode_interval(interval: Interval | None) -> Document | None:
    if interval is None:
        return None
    return {
        "mean": encode_number(interval.mean),
        "low": encode_optional(interval.low),
        "high": encode_optional(interval.high),
    }
