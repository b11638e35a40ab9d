"""The paper's table, turned on its side: one line per scheme, one column per metric; of the model and of real hosts alike."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import floor, log10
from typing import NamedTuple

from edgectl.experiments.model.comparison import Estimate, SchemeResult
from edgectl.formats.document import Document, encode_number
from edgectl.views.text import Cell, RenderOptions, Row, measure_column_widths, render_columns

_COLUMN_GAP = "  "
# Latencies below so many minutes are shown in seconds.
_SHORT_LATENCY_MIN = 2.0
_SMALL_PERCENT = 10.0


class MetricColumn(NamedTuple):
    """One column: its head, how its numbers are written, what it shows of a scheme, and whether the deviation always stands beside."""

    name: str
    head: str
    figures: Callable[[SchemeResult], Sequence[Estimate | None]]
    write: Callable[[float], str]
    spread: bool = False


def build_metric_column(
    name: str, head: str, digits: int = 0, factor: float = 1.0, *, spread: bool = False
) -> MetricColumn:
    """A metric that every experiment has."""
    return MetricColumn(
        name,
        head,
        lambda column: column.estimates.get(name, ()),
        lambda value: f"{factor * value:.{digits}f}",
        spread,
    )


def build_percent_column(name: str, head: str, values: Iterable[SchemeResult]) -> MetricColumn:
    """A share of a capacity: whole percent, or tenths where all are below 10."""
    means = (figure.mean for value in values for figure in value.estimates.get(name, ()) if figure)
    return build_metric_column(name, head, 0 if max(means, default=0.0) >= _SMALL_PERCENT else 1)


def build_latency_column(values: Iterable[SchemeResult]) -> MetricColumn:
    """Minutes as in the paper, or seconds where all are short."""
    means = [figure.mean for value in values for figure in value.estimates.get("latency", ()) if figure]
    short = max(means, default=0.0) < _SHORT_LATENCY_MIN
    return (
        build_metric_column("latency", "LATENCY s", 1, 60.0, spread=True)
        if short
        else build_metric_column("latency", "LATENCY min", 2, spread=True)
    )


def build_usage_columns(values: Sequence[SchemeResult]) -> tuple[MetricColumn, ...]:
    """How long the mission took and what the hosts used, which a model and real hosts have alike."""
    return (
        build_latency_column(values),
        build_percent_column("cpu", "CPU %", values),
        build_percent_column("cpu peak", "PEAK %", values),
        build_percent_column("memory", "MEMORY %", values),
        build_metric_column("throughput", "MB/s", 2),
    )


def build_application_column(name: str, values: Iterable[SchemeResult]) -> MetricColumn:
    """A metric that tasks wrote, whose unit nobody knows: three digits of the greatest mean, and as many decimals everywhere."""
    means = [abs(figure.mean) for value in values if (figure := value.metrics.get(name))]
    greatest = max(means, default=0.0)
    decimals = min(9, max(0, 2 - floor(log10(greatest)))) if greatest > 0 else 0
    return MetricColumn(
        name, name.upper(), lambda column: (column.metrics.get(name),), lambda value: f"{value:.{decimals}f}"
    )


def build_ssim_column(name: str) -> MetricColumn:
    """How like the truth a map is."""
    return MetricColumn(
        name, name.upper(), lambda column: (column.maps.get(name),), lambda value: f"{value:.3f}"
    )


def format_estimates(figures: Sequence[Estimate | None], metric: MetricColumn, *, spread: bool) -> str:
    """The means of one metric, one per host; with ``spread`` each with its deviation, where several runs have a value."""
    return (
        "/".join(_format_estimate(each, metric, spread=spread or metric.spread) for each in figures)
        if any(figures)
        else "-"
    )


def _format_estimate(figure: Estimate | None, metric: MetricColumn, *, spread: bool) -> str:
    if figure is None:
        return "-"
    return metric.write(figure.mean) + (f"±{metric.write(figure.std)}" if spread and figure.count > 1 else "")


def describe_table_numbers(*, every: bool) -> str:
    """What the numbers of the table are."""
    return "mean±deviation" if every else "mean±deviation of the latency, means of the rest"


def render_scheme_table(rows: Sequence[Row], look: RenderOptions) -> str:
    """Numbers to the right of the first column. What does not fit the terminal stands in tables of its own below, each with that column."""
    return "\n".join(
        render_columns(part, look, right=range(1, len(part[0]))) for part in _split_to_width(rows, look)
    )


def _split_to_width(rows: Sequence[Row], look: RenderOptions) -> Iterator[list[Row]]:
    first, *widths = measure_column_widths(rows)
    chosen: list[int] = []
    room = used = (look.width or 0) - first
    for place, width in enumerate(widths, 1):
        used -= width + len(_COLUMN_GAP)
        if look.width is not None and used < 0 and chosen:
            yield _select_table_columns(rows, chosen)
            chosen, used = [], room - width - len(_COLUMN_GAP)
        chosen.append(place)
    yield _select_table_columns(rows, chosen)


def _select_table_columns(rows: Sequence[Row], chosen: Sequence[int]) -> list[Row]:
    return [(row[0], *(row[place] for place in chosen)) for row in rows]


def describe_latency_ratios(
    values: Sequence[SchemeResult],
    told: Callable[[SchemeResult, SchemeResult], str] = lambda _value, _base: "",
) -> Iterator[str]:
    """How the latencies stand to those of local and static execution; ``told`` may say more of each pair."""
    means = {value.scheme.name: (value, mean) for value in values if (mean := get_mean_latency_min(value))}
    for name in ("local", "static"):
        if name in means:
            base, latency_of_base = means[name]
            parts = [
                f"{other} {mean / latency_of_base:.2f}{told(value, base)}"
                for other, (value, mean) in means.items()
                if other not in ("local", name)
            ]
            if parts:
                yield f"Latency as a share of {name} execution: {', '.join(parts)}."


def get_mean_latency_min(value: SchemeResult) -> float | None:
    """In minutes."""
    figure = next(iter(value.estimates.get("latency", ())), None)
    return figure.mean if figure else None


def describe_unfinished(values: Iterable[SchemeResult], what: str) -> list[str]:
    """A line for each scheme of which the limit ended some."""
    return [
        f"{value.scheme.name}: {what} given up at the limit: {value.unfinished}"
        for value in values
        if value.unfinished
    ]


def render_scheme_name(value: SchemeResult) -> Cell:
    """The name of a scheme."""
    return Cell(value.scheme.name, "name")


def encode_scheme_result(value: SchemeResult) -> Document:
    """Every figure of a scheme as JSON types."""
    return {
        "name": value.scheme.name,
        "runs": value.runs,
        "unfinished": value.unfinished,
        "unplaced": value.unplaced,
        "hosts": list(value.hosts),
        "figures": {
            metric: [_encode_estimate(each) for each in figures]
            for metric, figures in value.estimates.items()
        },
    }


def encode_application_metrics(value: SchemeResult) -> Document:
    """What tasks wrote and how like the truth maps are, as JSON types."""
    return {
        "metrics": {name: _encode_estimate(each) for name, each in value.metrics.items()},
        "ssim": {name: _encode_estimate(each) for name, each in value.maps.items()},
    }


def _encode_estimate(value: Estimate | None) -> Document | None:
    """The deviation of one run is not known."""
    if value is None:
        return None
    several = value.count > 1
    return {
        "mean": encode_number(value.mean), "std": encode_number(value.std) if several else None, "half_ci95": encode_number(value.half_ci95) if several else None,
        "runs": value.count,
    }  # fmt: skip
