"""The paper's table, turned on its side: one line per scheme, one column per metric; of the model and of real hosts alike."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import floor, log10
from typing import NamedTuple

from edgectl.formats.base import Document, number
from edgectl.model.evidence import Column, Figure
from edgectl.views.text import Cell, Look, Row, columns, widths_of

_GAP = "  "
# Latencies below so many minutes are shown in seconds.
_SHORT_MIN = 2.0
_SMALL_PERCENT = 10.0


class Metric(NamedTuple):
    """One column: its head, how its numbers are written, what it shows of a scheme, and whether the deviation always stands beside."""

    name: str
    head: str
    figures: Callable[[Column], Sequence[Figure | None]]
    write: Callable[[float], str]
    spread: bool = False


def of_all(name: str, head: str, digits: int = 0, factor: float = 1.0, *, spread: bool = False) -> Metric:
    """A metric that every experiment has."""
    return Metric(name, head, lambda column: column.figures.get(name, ()), lambda value: f"{factor * value:.{digits}f}", spread)


def percent(name: str, head: str, values: Iterable[Column]) -> Metric:
    """A share of a capacity: whole percent, or tenths where all are below 10."""
    means = (figure.mean for value in values for figure in value.figures.get(name, ()) if figure)
    return of_all(name, head, 0 if max(means, default=0.0) >= _SMALL_PERCENT else 1)


def latency(values: Iterable[Column]) -> Metric:
    """Minutes as in the paper, or seconds where all are short."""
    means = [figure.mean for value in values for figure in value.figures.get("latency", ()) if figure]
    short = max(means, default=0.0) < _SHORT_MIN
    return of_all("latency", "LATENCY s", 1, 60.0, spread=True) if short else of_all("latency", "LATENCY min", 2, spread=True)


def usage(values: Sequence[Column]) -> tuple[Metric, ...]:
    """How long the mission took and what the hosts used, which a model and real hosts have alike."""
    return (
        latency(values),
        percent("cpu", "CPU %", values),
        percent("cpu peak", "PEAK %", values),
        percent("memory", "MEMORY %", values),
        of_all("throughput", "MB/s", 2),
    )


def application(name: str, values: Iterable[Column]) -> Metric:
    """A metric that tasks wrote, whose unit nobody knows: three digits of the greatest mean, and as many decimals everywhere."""
    means = [abs(figure.mean) for value in values if (figure := value.metrics.get(name))]
    greatest = max(means, default=0.0)
    decimals = min(9, max(0, 2 - floor(log10(greatest)))) if greatest > 0 else 0
    return Metric(name, name.upper(), lambda column: (column.metrics.get(name),), lambda value: f"{value:.{decimals}f}")


def ssim(name: str) -> Metric:
    """How like the truth a map is."""
    return Metric(name, name.upper(), lambda column: (column.maps.get(name),), lambda value: f"{value:.3f}")


def text_of(figures: Sequence[Figure | None], metric: Metric, *, spread: bool) -> str:
    """The means of one metric, one per host; with ``spread`` each with its deviation, where several runs have a value."""
    return "/".join(_mean(each, metric, spread=spread or metric.spread) for each in figures) if any(figures) else "-"


def _mean(figure: Figure | None, metric: Metric, *, spread: bool) -> str:
    if figure is None:
        return "-"
    return metric.write(figure.mean) + (f"±{metric.write(figure.std)}" if spread and figure.count > 1 else "")


def numbers(*, every: bool) -> str:
    """What the numbers of the table are."""
    return "mean±deviation" if every else "mean±deviation of the latency, means of the rest"


def table(rows: Sequence[Row], look: Look) -> str:
    """Numbers to the right of the first column. What does not fit the terminal stands in tables of its own below, each with that column."""
    return "\n".join(columns(part, look, right=range(1, len(part[0]))) for part in _parts(rows, look))


def _parts(rows: Sequence[Row], look: Look) -> Iterator[list[Row]]:
    first, *widths = widths_of(rows)
    chosen: list[int] = []
    room = used = (look.width or 0) - first
    for place, width in enumerate(widths, 1):
        used -= width + len(_GAP)
        if look.width is not None and used < 0 and chosen:
            yield _only(rows, chosen)
            chosen, used = [], room - width - len(_GAP)
        chosen.append(place)
    yield _only(rows, chosen)


def _only(rows: Sequence[Row], chosen: Sequence[int]) -> list[Row]:
    return [(row[0], *(row[place] for place in chosen)) for row in rows]


def ratios(values: Sequence[Column], told: Callable[[Column, Column], str] = lambda _value, _base: "") -> Iterator[str]:
    """How the latencies stand to those of local and static execution; ``told`` may say more of each pair."""
    means = {value.variant.name: (value, mean) for value in values if (mean := mean_latency(value))}
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


def mean_latency(value: Column) -> float | None:
    """In minutes."""
    figure = next(iter(value.figures.get("latency", ())), None)
    return figure.mean if figure else None


def given_up(values: Iterable[Column], what: str) -> list[str]:
    """A line for each scheme of which the limit ended some."""
    return [f"{value.variant.name}: {what} given up at the limit: {value.unfinished}" for value in values if value.unfinished]


def scheme(value: Column) -> Cell:
    """The name of a scheme."""
    return Cell(value.variant.name, "name")


def document(value: Column) -> Document:
    """Every figure of a scheme as JSON types."""
    return {
        "name": value.variant.name,
        "runs": value.runs,
        "unfinished": value.unfinished,
        "unplaced": value.unplaced,
        "hosts": list(value.hosts),
        "figures": {metric: [_figure(each) for each in figures] for metric, figures in value.figures.items()},
    }


def applications(value: Column) -> Document:
    """What tasks wrote and how like the truth maps are, as JSON types."""
    return {
        "metrics": {name: _figure(each) for name, each in value.metrics.items()},
        "ssim": {name: _figure(each) for name, each in value.maps.items()},
    }


def _figure(value: Figure | None) -> Document | None:
    """The deviation of one run is not known."""
    if value is None:
        return None
    several = value.count > 1
    return {
        "mean": number(value.mean), "std": number(value.std) if several else None, "half_ci95": number(value.half) if several else None,
        "runs": value.count,
    }  # fmt: skip
