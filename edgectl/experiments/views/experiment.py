# SPDX-License-Identifier: Apache-2.0
"""Results of an experiment on real hosts: the paper's table as text, Markdown and a document."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from edgectl.experiments.model.comparison import SchemeComparison, SchemeResult
from edgectl.experiments.model.experiment import Experiment, ExperimentRun
from edgectl.experiments.scheme_comparison import MISSION_TIME, find_primary_comparison
from edgectl.experiments.views.answer import describe_answer
from edgectl.experiments.views.comparison_table import (
    describe_comparisons,
    encode_comparison,
    render_comparison_table,
)
from edgectl.experiments.views.recovery_table import (
    build_recovery_rows,
    describe_recovery,
    encode_events,
    render_recovery_table,
)
from edgectl.experiments.views.scheme_table import (
    MetricColumn,
    build_application_column,
    build_metric_column,
    build_ssim_column,
    build_usage_columns,
    describe_latency_ratios,
    describe_table_numbers,
    describe_unfinished,
    encode_application_metrics,
    encode_scheme_result,
    format_estimates,
    render_scheme_name,
    render_scheme_table,
)
from edgectl.formats.document import Document
from edgectl.views.output import ItemView, round_item
from edgectl.views.output_format import EXPERIMENT_FORMATS
from edgectl.views.plan import escape_markdown
from edgectl.views.text import PLAIN, RenderOptions, Row, escape_unprintable, wrap_text

_NARROW_METRICS = ("latency", "cpu", "memory", "handoffs", "gap")


@dataclass(frozen=True, kw_only=True)
class ExperimentView(ItemView):
    """A run and the results of its schemes (`summarize_trials`)."""

    kind = "experiment"
    formats = EXPERIMENT_FORMATS
    run: ExperimentRun
    results: Sequence[SchemeResult]
    comparisons: Sequence[SchemeComparison] = ()

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One row per scheme with its main metrics, then progress and latency ratios."""
        return self._render(look, every=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with all metrics, each with its interval."""
        return self._render(look, every=True)

    def markdown(self) -> str:
        """The wide table in Markdown, and its notes as a list."""
        rows = build_experiment_rows(self.run.experiment, self.results, every=True)
        recovery = build_recovery_rows(self.results)
        tables = [_render_markdown_table(each) + "\n" for each in (rows, recovery) if each]
        notes = self._list_notes(every=True)
        return "".join((*tables, *(f"- {escape_markdown(note)}\n" for note in notes)))

    def item(self) -> Document:
        """All estimates as JSON types.

        Latency in min, CPU and memory in percent, throughput in MB/s, downtime, gap and cpu_s in s, air
        in MB, energy in kJ.
        """
        return {
            "experiment": self.run.experiment.name,
            "digest": self.run.digest,
            "planned": self.run.experiment.repetitions,
            "trials": sum(result.runs for result in self.results),
            "answer": describe_answer(find_primary_comparison(self.comparisons)),
            "comparisons": [encode_comparison(each) for each in self.comparisons],
            "schemes": [
                {
                    **encode_scheme_result(result),
                    **encode_application_metrics(result),
                    **encode_events(result, self.run.experiment.events),
                }
                for result in self.results
            ],
        }

    def rows(self) -> Sequence[Document]:
        """One row per scheme."""
        schemes: Sequence[Document] = round_item(self.item())["schemes"]  # type: ignore[assignment]
        return schemes

    def _render(self, look: RenderOptions, *, every: bool) -> str:
        rows = build_experiment_rows(self.run.experiment, self.results, every=every)
        text = "".join(wrap_text(escape_unprintable(note), look) for note in self._list_notes(every=every))
        columns = list_compared_columns(self.run.experiment, self.results, every=every)
        compared = render_comparison_table(self.comparisons, columns, look)
        recovery = render_recovery_table(self.results, look)
        return f"{render_scheme_table(rows, look)}{recovery}\n{compared}{text}"

    def _list_notes(self, *, every: bool) -> Iterator[str]:
        """The answer, where there is one, and the notes on the tables."""
        if self.comparisons:
            yield describe_answer(find_primary_comparison(self.comparisons))
        yield from describe_experiment(self.run.experiment, self.results, self.comparisons, every=every)


def _render_markdown_table(rows: Sequence[Row]) -> str:
    heading, *body = ([cell if isinstance(cell, str) else cell.text for cell in row] for row in rows)
    lines = [heading, ["---", *["---:"] * (len(heading) - 1)]]
    lines += ([escape_markdown(cell) for cell in row] for row in body)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def build_experiment_rows(
    experiment: Experiment, results: Sequence[SchemeResult], *, every: bool
) -> list[Row]:
    """The heading and a row per scheme; ``every``: all metrics, each with its interval.

    The column TRIALS is left out of the narrow table once no trial is missing.
    """
    planned = experiment.repetitions
    counted = every or any(result.runs < planned for result in results)
    columns = _build_experiment_columns(experiment, results, every=every)
    rows: list[Row] = [("SCHEME", *(["TRIALS"] if counted else []), *(column.heading for column in columns))]
    for result in results:
        trials = [f"{result.runs}/{planned}"] if counted else []
        cells = [format_estimates(column.estimates(result), column, spread=every) for column in columns]
        rows.append((render_scheme_name(result), *trials, *cells))
    return rows


def _build_experiment_columns(
    experiment: Experiment, results: Sequence[SchemeResult], *, every: bool
) -> list[MetricColumn]:
    common = (
        *build_usage_columns(results),
        build_metric_column("handoffs", "HANDOFFS", 1),
        build_metric_column("downtime", "DOWNTIME s", 1),
        *_build_counter_columns(results),
        build_metric_column("unplaced", "UNPLACED", 1),
    )
    return [
        *(column for column in common if every or column.name in _NARROW_METRICS),
        *(build_application_column(name, results) for name in experiment.metrics),
        *map(build_ssim_column, experiment.maps),
    ]


def list_compared_columns(
    experiment: Experiment, results: Sequence[SchemeResult], *, every: bool
) -> list[MetricColumn]:
    """The columns of which schemes are compared: the time of the mission, or with ``every`` all."""
    columns = _build_experiment_columns(experiment, results, every=every)
    return [column for column in columns if every or column.name == MISSION_TIME]


def _build_counter_columns(results: Sequence[SchemeResult]) -> list[MetricColumn]:
    """The columns of figures that earlier releases did not record, where a scheme has them."""
    columns = (
        build_metric_column("gap", "GAP s", 1),
        build_metric_column("cpu_s", "CPU s", 1),
        build_metric_column("air", "AIR MB", 1),
        build_metric_column("energy", "ENERGY kJ", 1),
    )
    return [column for column in columns if any(any(column.estimates(result)) for result in results)]


def describe_experiment(
    experiment: Experiment,
    results: Sequence[SchemeResult],
    comparisons: Sequence[SchemeComparison] = (),
    *,
    every: bool = False,
) -> Iterator[str]:
    """The notes below the table of the same ``every``."""
    done, planned = sum(result.runs for result in results), experiment.repetitions * len(results)
    hosts = next((result.hosts for result in results if result.hosts), ())
    by_edge = f", by edge ({'/'.join(hosts)}; local: mean of the robots)" if hosts else ""
    yield f"{done} of {planned} trials of {experiment.name}; {describe_table_numbers(every=every)}{by_edge}."
    yield from describe_comparisons(comparisons)
    yield from describe_unfinished(results, "trials")
    yield from describe_recovery(results, experiment.events)
    yield from (
        f"{result.scheme.name}: unplaced tasks, summed over all plans: {result.unplaced}"
        for result in results
        if result.unplaced
    )
    yield from describe_latency_ratios(results)
