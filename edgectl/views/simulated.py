"""What a model says of each scheme beside what is known of the real thing, as text and as a document."""

from collections.abc import Iterable, Sequence

from edgectl.formats.base import FORMAT_VERSION, Document, optional
from edgectl.model.evidence import Column, Reality
from edgectl.model.scenario import Scenario
from edgectl.views.columns import Metric, document, given_up, numbers, of_all, ratios, scheme, table, text_of, usage
from edgectl.views.text import PLAIN, Cell, Look, Row, flowed

_MAIN = ("latency", "cpu", "memory", "rate", "handoffs")


def text(scenario: Scenario, values: Iterable[Column], real: Reality, look: Look = PLAIN, *, every: bool = False) -> str:
    """One line per scheme, with what is known of it and how far the model is off below; then every assumption."""
    found = list(values)
    metrics = [metric for metric in _metrics(found) if _shown(metric, found, real, every=every)]
    rows: list[Row] = [("SCHEME", *(metric.head for metric in metrics))]
    for value in found:
        known = real.figures.get(value.variant.name, {})
        rows.append((scheme(value), *(text_of(metric.figures(value), metric, spread=every) for metric in metrics)))
        if known:
            rows.append((Cell(f"  {real.word}", "dim"), *(_written(metric, known.get(metric.name, ())) for metric in metrics)))
            rows.append((Cell("  off by", "dim"), *(_off_by(value, metric.name, known.get(metric.name, ())) for metric in metrics)))
    runs = max((value.runs for value in found), default=0)
    lines = [f"{runs} run{'' if runs == 1 else 's'} of each scheme; {numbers(every=every)}, by edge (local: of the robots)."]
    lines += [*given_up(found, "runs"), *ratios(found, lambda value, base: _ratio(real, value, base)), *real.notes]
    lines += ["Assumptions, the same for every scheme:", *(f"- {line}" for line in scenario.assumptions)]
    return table(rows, look) + "\n" + "".join(flowed(line, look) for line in lines)


def _metrics(values: Sequence[Column]) -> tuple[Metric, ...]:
    return (
        *usage(values),
        of_all("rate", "FRAMES/s", 1),
        of_all("ssim", "SSIM", 2),
        of_all("handoffs", "HANDOFFS", 1),
    )


def _shown(metric: Metric, values: Sequence[Column], real: Reality, *, every: bool) -> bool:
    """SSIM, which no model has, only where something is known of it."""
    modelled = any(any(metric.figures(value)) for value in values)
    return metric.name in _MAIN or (every and (modelled or any(metric.name in known for known in real.figures.values())))


def _written(metric: Metric, values: Sequence[float | None]) -> str:
    return "/".join("-" if value is None else metric.write(value) for value in values) or "-"


def _off_by(value: Column, metric: str, known: Sequence[float | None]) -> str:
    return "/".join("-" if share is None else _percent(share) for share in _deviations(value, metric, known)) or "-"


def _deviations(value: Column, metric: str, known: Sequence[float | None]) -> list[float | None]:
    """How far each mean of the model is off, as a share of what is known: of one number of the whole, the mean over the hosts."""
    means = [figure.mean if figure else None for figure in value.figures.get(metric, ())]
    if len(known) == 1 < len(means):
        found = [mean for mean in means if mean is not None]
        means = [sum(found) / len(found) if found else None]
    if len(means) != len(known):
        return []
    return [(mean - real) / real if mean is not None and real else None for mean, real in zip(means, known, strict=True)]


def _percent(share: float) -> str:
    """Signed whole percent; nothing is +0%."""
    return f"{round(100 * share) + 0:+d}%"


def _ratio(real: Reality, value: Column, base: Column) -> str:
    """The same share in reality."""
    known = [next(iter(real.figures.get(each.variant.name, {}).get("latency", ())), None) for each in (value, base)]
    return f" ({real.word} {known[0] / known[1]:.2f})" if known[0] and known[1] else ""


def as_document(scenario: Scenario, values: Iterable[Column], real: Reality) -> Document:
    """Every figure as JSON types; what is known of the real thing beside it, and how far the model is off, as a share of that."""
    return {
        "format_version": FORMAT_VERSION,
        "scenario": scenario.name,
        "assumptions": list(scenario.assumptions),
        "notes": list(real.notes),
        "schemes": [_scheme(value, real) for value in values],
    }


def _scheme(value: Column, real: Reality) -> Document:
    known = real.figures.get(value.variant.name, {})
    return {
        **document(value),
        real.word: {metric: [optional(each) for each in figures] for metric, figures in known.items()},
        "off_by": {metric: [optional(each) for each in _deviations(value, metric, figures)] for metric, figures in known.items()},
    }
