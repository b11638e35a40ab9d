# SPDX-License-Identifier: Apache-2.0
"""Results of a simulation beside reference values of real hosts: text and a document."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from edgectl.experiments.model.comparison import ReferenceValues, SchemeComparison, SchemeResult
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.scheme_comparison import MISSION_TIME, find_primary_comparison
from edgectl.experiments.views.answer import describe_answer
from edgectl.experiments.views.comparison_table import (
    describe_comparisons,
    encode_comparison,
    render_comparison_table,
)
from edgectl.experiments.views.recovery_table import (
    describe_recovery,
    encode_events,
    render_recovery_table,
)
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
from edgectl.formats.document import Document, encode_optional
from edgectl.views.output import ItemView, round_item
from edgectl.views.output_format import WIDE_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, wrap_text

_NARROW_METRICS = ("latency", "cpu", "memory", "handoffs")


@dataclass(frozen=True, kw_only=True)
class SimulationView(ItemView):
    """A scenario, the simulated results of its schemes, and the reference values of the comparison."""

    kind = "simulation"
    formats = WIDE_FORMATS
    scenario: Scenario
    results: Sequence[SchemeResult]
    reference: ReferenceValues
    comparisons: Sequence[SchemeComparison] = ()

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Per scheme its main metrics, reference values and deviations; then notes and all assumptions."""
        return self._render(look, every=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with all metrics, each with its interval."""
        return self._render(look, every=True)

    def item(self) -> Document:
        """All estimates as JSON types, beside the reference values and the relative deviations from them."""
        return {
            "scenario": self.scenario.name,
            "reference": self.reference.label,
            "assumptions": list(self.scenario.assumptions),
            "notes": list(self.reference.notes),
            "answer": describe_answer(find_primary_comparison(self.comparisons)),
            "comparisons": [encode_comparison(each) for each in self.comparisons],
            "schemes": [self._encode_scheme(result) for result in self.results],
        }

    def rows(self) -> Sequence[Document]:
        """One row per scheme."""
        schemes: Sequence[Document] = round_item(self.item())["schemes"]  # type: ignore[assignment]
        return schemes

    def _encode_scheme(self, result: SchemeResult) -> Document:
        known = self.reference.means.get(result.scheme.name, {})
        return {
            **encode_scheme_result(result),
            **encode_events(result, self.scenario.events),
            "reference_figures": {
                metric: [encode_optional(mean) for mean in means] for metric, means in known.items()
            },
            "off_by": {
                metric: [encode_optional(share) for share in _compute_deviations(result, metric, means)]
                for metric, means in known.items()
            },
        }

    def _render(self, look: RenderOptions, *, every: bool) -> str:
        columns = [
            column
            for column in _build_simulation_columns(self.results)
            if _is_column_shown(column, self.results, self.reference, every=every)
        ]
        rows: list[Row] = [("SCHEME", *(column.heading for column in columns))]
        for result in self.results:
            rows += _build_scheme_rows(result, self.reference, columns, every=every)
        notes = "".join(wrap_text(note, look) for note in self._describe(every=every))
        shown = columns if every else [column for column in columns if column.name == MISSION_TIME]
        compared = render_comparison_table(self.comparisons, shown, look)
        recovery = render_recovery_table(self.results, look)
        return f"{render_scheme_table(rows, look)}{recovery}\n{compared}{notes}"

    def _describe(self, *, every: bool) -> Iterator[str]:
        """The notes below the table."""
        runs = max((result.runs for result in self.results), default=0)
        numbers = describe_table_numbers(every=every)
        noun = "run" if runs == 1 else "runs"
        if self.comparisons:
            yield describe_answer(find_primary_comparison(self.comparisons))
        yield f"{runs} {noun} of each scheme; {numbers}, by edge (local: of the robots)."
        yield from describe_comparisons(self.comparisons)
        yield from describe_unfinished(self.results, "runs")
        yield from describe_recovery(self.results, self.scenario.events)
        yield from _describe_lost_hosts(self.scenario, self.results)
        yield from describe_latency_ratios(
            self.results, lambda result, base: _format_reference_ratio(self.reference, result, base)
        )
        yield from self.reference.notes
        yield "Assumptions, the same for every scheme:"
        yield from (f"- {assumption}" for assumption in self.scenario.assumptions)


def _build_simulation_columns(results: Sequence[SchemeResult]) -> tuple[MetricColumn, ...]:
    return (
        *build_usage_columns(results),
        build_metric_column("rate", "FRAMES/s", 1),
        build_metric_column("ssim", "SSIM", 2),
        build_metric_column("handoffs", "HANDOFFS", 1),
    )


def _is_column_shown(
    column: MetricColumn, results: Sequence[SchemeResult], reference: ReferenceValues, *, every: bool
) -> bool:
    """Whether the table has the column: a rate only if it is simulated, SSIM only if the reference has it."""
    simulated = any(any(column.estimates(result)) for result in results)
    if column.name == "rate":
        return simulated
    return column.name in _NARROW_METRICS or (
        every and (simulated or any(column.name in means for means in reference.means.values()))
    )


def _build_scheme_rows(
    result: SchemeResult, reference: ReferenceValues, columns: Sequence[MetricColumn], *, every: bool
) -> Iterator[Row]:
    """The row of a scheme; below it its reference values and the deviations from them, if there are any."""
    yield (
        render_scheme_name(result),
        *(format_estimates(column.estimates(result), column, spread=every) for column in columns),
    )
    means = reference.means.get(result.scheme.name, {})
    if means:
        yield (
            Cell(f"  {reference.label}", "dim"),
            *(_format_reference_means(column, means.get(column.name, ())) for column in columns),
        )
        yield (
            Cell("  off by", "dim"),
            *(_format_deviations(result, column.name, means.get(column.name, ())) for column in columns),
        )


def _format_reference_means(column: MetricColumn, means: Sequence[float | None]) -> str:
    return "/".join("-" if mean is None else column.format_number(mean) for mean in means) or "-"


def _format_deviations(result: SchemeResult, metric: str, means: Sequence[float | None]) -> str:
    shares = _compute_deviations(result, metric, means)
    return "/".join("-" if share is None else _format_signed_percent(share) for share in shares) or "-"


def _compute_deviations(
    result: SchemeResult, metric: str, reference: Sequence[float | None]
) -> list[float | None]:
    """(simulated - reference) / reference of each mean; a single reference: of the mean over the hosts."""
    means = [each.mean if each else None for each in result.estimates.get(metric, ())]
    if len(reference) == 1 < len(means):
        known = [mean for mean in means if mean is not None]
        means = [sum(known) / len(known) if known else None]
    if len(means) != len(reference):
        return []
    return [
        (mean - real) / real if mean is not None and real else None
        for mean, real in zip(means, reference, strict=True)
    ]


def _format_signed_percent(share: float) -> str:
    """Signed whole percent; zero is ``+0%``, never ``-0%``."""
    return f"{round(100 * share) + 0:+d}%"


def _format_reference_ratio(reference: ReferenceValues, result: SchemeResult, base: SchemeResult) -> str:
    """The latency ratio of the same two schemes in the reference."""
    latencies = [
        next(iter(reference.means.get(each.scheme.name, {}).get("latency", ())), None)
        for each in (result, base)
    ]
    if not latencies[0] or not latencies[1]:
        return ""
    return f" ({reference.label} {latencies[0] / latencies[1]:.2f})"


def _describe_lost_hosts(scenario: Scenario, results: Sequence[SchemeResult]) -> Iterator[str]:
    """Why runs reach the limit where a host is lost for good."""
    if any(result.unfinished for result in results):
        yield from (
            f"{event.lost} stays lost, because event {event.name} has no for: its tasks wait for it unless "
            "they state on_unreachable: replace"
            for event in scenario.events
            if event.lost is not None and event.duration is None
        )
