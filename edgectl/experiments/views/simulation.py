"""What a model says of each scheme beside what is known of the real thing, as text and as a document."""

from collections.abc import Iterable, Sequence

from edgectl.experiments.model.comparison import ReferenceValues, SchemeResult
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.views.scheme_table import (
    MetricColumn,
    build_metric_column,
    build_usage_columns,
    describe_latency_ratios,
    describe_table_numbers,
    describe_unfinished,
    encode_scheme_result,
    format_estimates,
    render_scheme_name,
    render_scheme_table,
)
from edgectl.formats.document import FORMAT_VERSION, Document, encode_optional
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, wrap_text

_MAIN_SIMULATED_METRICS = ("latency", "cpu", "memory", "rate", "handoffs")


def render_simulation(
    scenario: Scenario,
    values: Iterable[SchemeResult],
    real: ReferenceValues,
    look: RenderOptions = PLAIN,
    *,
    every: bool = False,
) -> str:
    """One line per scheme, with what is known of it and how far the model is off below; then every assumption."""
    found = list(values)
    metrics = [
        metric
        for metric in _build_simulation_columns(found)
        if _is_column_shown(metric, found, real, every=every)
    ]
    rows: list[Row] = [("SCHEME", *(metric.head for metric in metrics))]
    for value in found:
        known = real.means.get(value.scheme.name, {})
        rows.append(
            (
                render_scheme_name(value),
                *(format_estimates(metric.figures(value), metric, spread=every) for metric in metrics),
            )
        )
        if known:
            rows.append(
                (
                    Cell(f"  {real.label}", "dim"),
                    *(_format_reference_means(metric, known.get(metric.name, ())) for metric in metrics),
                )
            )
            rows.append(
                (
                    Cell("  off by", "dim"),
                    *(
                        _format_deviations(value, metric.name, known.get(metric.name, ()))
                        for metric in metrics
                    ),
                )
            )
    runs = max((value.runs for value in found), default=0)
    lines = [
        f"{runs} run{'' if runs == 1 else 's'} of each scheme; {describe_table_numbers(every=every)}, by edge (local: of the robots)."
    ]
    lines += [
        *describe_unfinished(found, "runs"),
        *describe_latency_ratios(found, lambda value, base: _format_reference_ratio(real, value, base)),
        *real.notes,
    ]
    lines += ["Assumptions, the same for every scheme:", *(f"- {line}" for line in scenario.assumptions)]
    return render_scheme_table(rows, look) + "\n" + "".join(wrap_text(line, look) for line in lines)


def _build_simulation_columns(values: Sequence[SchemeResult]) -> tuple[MetricColumn, ...]:
    return (
        *build_usage_columns(values),
        build_metric_column("rate", "FRAMES/s", 1),
        build_metric_column("ssim", "SSIM", 2),
        build_metric_column("handoffs", "HANDOFFS", 1),
    )


def _is_column_shown(
    metric: MetricColumn, values: Sequence[SchemeResult], real: ReferenceValues, *, every: bool
) -> bool:
    """SSIM, which no model has, only where something is known of it."""
    modelled = any(any(metric.figures(value)) for value in values)
    return metric.name in _MAIN_SIMULATED_METRICS or (
        every and (modelled or any(metric.name in known for known in real.means.values()))
    )


def _format_reference_means(metric: MetricColumn, values: Sequence[float | None]) -> str:
    return "/".join("-" if value is None else metric.write(value) for value in values) or "-"


def _format_deviations(value: SchemeResult, metric: str, known: Sequence[float | None]) -> str:
    return (
        "/".join(
            "-" if share is None else _format_signed_percent(share)
            for share in _compute_deviations(value, metric, known)
        )
        or "-"
    )


def _compute_deviations(
    value: SchemeResult, metric: str, known: Sequence[float | None]
) -> list[float | None]:
    """How far each mean of the model is off, as a share of what is known: of one number of the whole, the mean over the hosts."""
    means = [figure.mean if figure else None for figure in value.estimates.get(metric, ())]
    if len(known) == 1 < len(means):
        found = [mean for mean in means if mean is not None]
        means = [sum(found) / len(found) if found else None]
    if len(means) != len(known):
        return []
    return [
        (mean - real) / real if mean is not None and real else None
        for mean, real in zip(means, known, strict=True)
    ]


def _format_signed_percent(share: float) -> str:
    """Signed whole percent; nothing is +0%."""
    return f"{round(100 * share) + 0:+d}%"


def _format_reference_ratio(real: ReferenceValues, value: SchemeResult, base: SchemeResult) -> str:
    """The same share in reality."""
    known = [
        next(iter(real.means.get(each.scheme.name, {}).get("latency", ())), None) for each in (value, base)
    ]
    return f" ({real.label} {known[0] / known[1]:.2f})" if known[0] and known[1] else ""


def encode_simulation(scenario: Scenario, values: Iterable[SchemeResult], real: ReferenceValues) -> Document:
    """Every figure as JSON types; what is known of the real thing beside it, and how far the model is off, as a share of that."""
    return {
        "format_version": FORMAT_VERSION,
        "scenario": scenario.name,
        "assumptions": list(scenario.assumptions),
        "notes": list(real.notes),
        "schemes": [_encode_simulated_scheme(value, real) for value in values],
    }


def _encode_simulated_scheme(value: SchemeResult, real: ReferenceValues) -> Document:
    known = real.means.get(value.scheme.name, {})
    return {
        **encode_scheme_result(value),
        real.label: {
            metric: [encode_optional(each) for each in figures] for metric, figures in known.items()
        },
        "off_by": {
            metric: [encode_optional(each) for each in _compute_deviations(value, metric, figures)]
            for metric, figures in known.items()
        },
    }
