"""The paper's table of an experiment on real hosts: text, Markdown and a document."""

from collections.abc import Callable, Iterator, Sequence

from edgectl.experiments.model.comparison import SchemeResult
from edgectl.experiments.model.experiment import Experiment, ExperimentRun
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
from edgectl.formats.document import FORMAT_VERSION, Document
from edgectl.views.text import PLAIN, RenderOptions, Row, escape_unprintable, wrap_text

_MAIN_MEASURED_METRICS = ("latency", "cpu", "memory", "handoffs")


def render_experiment(
    run: ExperimentRun, values: Sequence[SchemeResult], look: RenderOptions = PLAIN, *, every: bool = False
) -> str:
    """One line per scheme, also where nothing is done yet; then how much of the experiment that is, and the latencies compared."""
    lines = "".join(
        wrap_text(escape_unprintable(line), look)
        for line in describe_experiment(run.experiment, values, every=every)
    )
    return (
        render_scheme_table(build_experiment_rows(run.experiment, values, every=every), look) + "\n" + lines
    )


def build_experiment_rows(
    experiment: Experiment, values: Sequence[SchemeResult], *, every: bool
) -> list[Row]:
    """The head and a row per scheme; with ``every`` all metrics, each with its deviation. Trials are counted where some are missing."""
    planned = experiment.repetitions
    counted = every or any(value.runs < planned for value in values)
    metrics = _build_experiment_columns(experiment, values, every=every)
    found: list[Row] = [("SCHEME", *(["TRIALS"] if counted else []), *(metric.head for metric in metrics))]
    for value in values:
        trials = [f"{value.runs}/{planned}"] if counted else []
        found.append(
            (
                render_scheme_name(value),
                *trials,
                *(format_estimates(metric.figures(value), metric, spread=every) for metric in metrics),
            )
        )
    return found


def _build_experiment_columns(
    experiment: Experiment, values: Sequence[SchemeResult], *, every: bool
) -> list[MetricColumn]:
    common = (
        *build_usage_columns(values),
        build_metric_column("handoffs", "HANDOFFS", 1),
        build_metric_column("downtime", "DOWNTIME s", 1),
        build_metric_column("unplaced", "UNPLACED", 1),
    )
    own = [
        *(build_application_column(name, values) for name in experiment.metrics),
        *map(build_ssim_column, experiment.maps),
    ]
    return [*(metric for metric in common if every or metric.name in _MAIN_MEASURED_METRICS), *own]


def describe_experiment(
    experiment: Experiment, values: Sequence[SchemeResult], *, every: bool = False
) -> Iterator[str]:
    """What stands below the table of the same ``every``."""
    done, planned = sum(value.runs for value in values), experiment.repetitions * len(values)
    hosts = next((value.hosts for value in values if value.hosts), ())
    by = f", by edge ({'/'.join(hosts)}; local: mean of the robots)" if hosts else ""
    yield f"{done} of {planned} trials of {experiment.name}; {describe_table_numbers(every=every)}{by}."
    yield from describe_unfinished(values, "trials")
    yield from (
        f"{value.scheme.name}: tasks without a host, over all plans: {value.unplaced}"
        for value in values
        if value.unplaced
    )
    yield from describe_latency_ratios(values)


def render_experiment_markdown(
    run: ExperimentRun, values: Sequence[SchemeResult], escaped: Callable[[str], str] = escape_unprintable
) -> str:
    """Everything as a table of Markdown."""
    head, *body = (
        [cell if isinstance(cell, str) else cell.text for cell in row]
        for row in build_experiment_rows(run.experiment, values, every=True)
    )
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *([escaped(cell) for cell in row] for row in body)]
    table_text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    return (
        table_text
        + "\n"
        + "".join(f"- {escaped(line)}\n" for line in describe_experiment(run.experiment, values, every=True))
    )


def encode_experiment_results(run: ExperimentRun, values: Sequence[SchemeResult]) -> Document:
    """Every figure as JSON types. Latency in min, cpu, cpu peak and memory in percent, throughput in MB/s, downtime in s."""
    return {
        "format_version": FORMAT_VERSION,
        "experiment": run.experiment.name,
        "digest": run.digest,
        "planned": run.experiment.repetitions,
        "done": sum(value.runs for value in values),
        "schemes": [{**encode_scheme_result(value), **encode_application_metrics(value)} for value in values],
    }
