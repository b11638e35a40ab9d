"""The paper's table, transposed: a row per scheme, a column per metric; of simulations and experiments."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import floor, log10
from typing import NamedTuple

from edgectl.experiments.model.comparison import Estimate, SchemeResult
from edgectl.formats.document import Document, encode_number
from edgectl.views.text import Cell, RenderOptions, Row, measure_column_widths, render_columns

_COLUMN_GAP = "  "
# Times of missions are in seconds where all means are below this, else in minutes.
SHORT_MISSION_S = 120.0
_SMALL_PERCENT = 10.0


class MetricColumn(NamedTuple):
    """A column: its heading, the estimates it takes from a scheme, the format of a number.

    ``spread``: show the interval in the narrow table too.
    """

    name: str
    heading: str
    estimates: Callable[[SchemeResult], Sequence[Estimate | None]]
    format_number: Callable[[float], str]
    spread: bool = False


def build_metric_column(
    name: str, heading: str, digits: int = 0, factor: float = 1.0, *, spread: bool = False
) -> MetricColumn:
    """A column of a metric that all experiments have; values are multiplied by ``factor``."""
    return MetricColumn(
        name,
        heading,
        lambda result: result.estimates.get(name, ()),
        lambda number: f"{factor * number:.{digits}f}",
        spread,
    )


def build_percent_column(name: str, heading: str, results: Iterable[SchemeResult]) -> MetricColumn:
    """A column of shares of a capacity in whole percent, or in tenths if all means are below 10 %."""
    means = (each.mean for result in results for each in result.estimates.get(name, ()) if each)
    return build_metric_column(name, heading, 0 if max(means, default=0.0) >= _SMALL_PERCENT else 1)


def build_latency_column(results: Iterable[SchemeResult]) -> MetricColumn:
    """Latency in minutes as in the paper, or in seconds if all means are short."""
    means = [each.mean for result in results for each in result.estimates.get("latency", ()) if each]
    short = max(means, default=0.0) < SHORT_MISSION_S / 60
    return (
        build_metric_column("latency", "LATENCY s", 1, 60.0, spread=True)
        if short
        else build_metric_column("latency", "LATENCY min", 2, spread=True)
    )


def build_usage_columns(results: Sequence[SchemeResult]) -> tuple[MetricColumn, ...]:
    """Latency and host usage: the columns that simulations and real experiments share."""
    return (
        build_latency_column(results),
        build_percent_column("cpu", "CPU %", results),
        build_percent_column("cpu peak", "PEAK %", results),
        build_percent_column("memory", "MEMORY %", results),
        build_metric_column("throughput", "MB/s", 2),
    )


def build_application_column(name: str, results: Iterable[SchemeResult]) -> MetricColumn:
    """A metric of the application, in an unknown unit: the largest mean has three digits."""
    means = [abs(each.mean) for result in results if (each := result.metrics.get(name))]
    largest = max(means, default=0.0)
    decimals = min(9, max(0, 2 - floor(log10(largest)))) if largest > 0 else 0
    return MetricColumn(
        name,
        name.upper(),
        lambda result: (result.metrics.get(name),),
        lambda number: f"{number:.{decimals}f}",
    )


def build_ssim_column(name: str) -> MetricColumn:
    """SSIM of the map ``name`` against its ground truth."""
    return MetricColumn(
        name, name.upper(), lambda result: (result.maps.get(name),), lambda number: f"{number:.3f}"
    )


def format_estimates(estimates: Sequence[Estimate | None], column: MetricColumn, *, spread: bool) -> str:
    """The means of a metric, one per host; ``spread``: each with half of its 95 % interval."""
    if not any(estimates):
        return "-"
    return "/".join(_format_estimate(each, column, spread=spread or column.spread) for each in estimates)


def _format_estimate(estimate: Estimate | None, column: MetricColumn, *, spread: bool) -> str:
    if estimate is None:
        return "-"
    half = (
        f"±{column.format_number(estimate.half_ci95)}"
        if spread and estimate.count > 1 and estimate.std
        else ""
    )
    return column.format_number(estimate.mean) + half


def describe_table_numbers(*, every: bool) -> str:
    """The statistics in the cells of the table."""
    interval = "mean±half of the 95 % interval"
    return interval if every else f"{interval} of the latency, means of the rest"


def render_scheme_table(rows: Sequence[Row], look: RenderOptions) -> str:
    """The table, split to the terminal's width into tables that each repeat the first column."""
    return "\n".join(
        render_columns(part, look, right=range(1, len(part[0]))) for part in _split_to_width(rows, look)
    )


def _split_to_width(rows: Sequence[Row], look: RenderOptions) -> Iterator[list[Row]]:
    first, *widths = measure_column_widths(rows)
    chosen: list[int] = []
    available = left = (look.width or 0) - first
    for column, width in enumerate(widths, 1):
        left -= width + len(_COLUMN_GAP)
        if look.width is not None and left < 0 and chosen:
            yield _select_table_columns(rows, chosen)
            chosen, left = [], available - width - len(_COLUMN_GAP)
        chosen.append(column)
    yield _select_table_columns(rows, chosen)


def _select_table_columns(rows: Sequence[Row], chosen: Sequence[int]) -> list[Row]:
    return [(row[0], *(row[column] for column in chosen)) for row in rows]


def _no_reference(_result: SchemeResult, _base: SchemeResult) -> str:
    return ""


def describe_latency_ratios(
    results: Sequence[SchemeResult],
    describe_reference: Callable[[SchemeResult, SchemeResult], str] = _no_reference,
) -> Iterator[str]:
    """Latencies relative to local and static execution; ``describe_reference`` is appended to each ratio."""
    means = {
        result.scheme.name: (result, mean) for result in results if (mean := get_mean_latency_min(result))
    }
    for name in ("local", "static"):
        if name in means:
            base, base_latency = means[name]
            parts = [
                f"{other} {mean / base_latency:.2f}{describe_reference(result, base)}"
                for other, (result, mean) in means.items()
                if other not in ("local", name)
            ]
            if parts:
                yield f"Latency as a share of {name} execution: {', '.join(parts)}."


def get_mean_latency_min(result: SchemeResult) -> float | None:
    """Mean latency in minutes; None without a run."""
    estimate = next(iter(result.estimates.get("latency", ())), None)
    return estimate.mean if estimate else None


def describe_unfinished(results: Iterable[SchemeResult], noun: str) -> list[str]:
    """One line per scheme with runs that reached the time limit; ``noun``: "runs" or "trials"."""
    return [
        f"{result.scheme.name}: {noun} ended by the time limit: {result.unfinished}"
        for result in results
        if result.unfinished
    ]


def render_scheme_name(result: SchemeResult) -> Cell:
    """The first cell of a row."""
    return Cell(result.scheme.name, "name")


def encode_scheme_result(result: SchemeResult) -> Document:
    """The estimates of a scheme as JSON types."""
    return {
        "scheme": result.scheme.name,
        "run_count": result.runs,
        "unfinished": result.unfinished,
        "unplaced": result.unplaced,
        "host_names": list(result.hosts),
        "figures": {
            metric: [_encode_estimate(each) for each in estimates]
            for metric, estimates in result.estimates.items()
        },
    }


def encode_application_metrics(result: SchemeResult) -> Document:
    """Application metrics and SSIM of maps as JSON types."""
    return {
        "metrics": {name: _encode_estimate(each) for name, each in result.metrics.items()},
        "maps": {name: _encode_estimate(each) for name, each in result.maps.items()},
    }


def _encode_estimate(estimate: Estimate | None) -> Document | None:
    """A single run has no deviation: null."""
    if estimate is None:
        return None
    several = estimate.count > 1
    return {
        "mean": encode_number(estimate.mean),
        "std": encode_number(estimate.std) if several else None,
        "half_ci95": encode_number(estimate.half_ci95) if several else None,
        "run_count": estimate.count,
    }
