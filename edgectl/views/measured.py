"""The paper's table of an experiment on real hosts: text, Markdown and a document."""

from collections.abc import Callable, Iterator, Sequence

from edgectl.formats.base import FORMAT_VERSION, Document
from edgectl.model.evidence import Column
from edgectl.model.experiment import Experiment, Run
from edgectl.views.columns import (
    Metric,
    application,
    applications,
    document,
    given_up,
    numbers,
    of_all,
    ratios,
    scheme,
    ssim,
    table,
    text_of,
    usage,
)
from edgectl.views.text import PLAIN, Look, Row, flowed, harmless

_MAIN = ("latency", "cpu", "memory", "handoffs")


def text(run: Run, values: Sequence[Column], look: Look = PLAIN, *, every: bool = False) -> str:
    """One line per scheme, also where nothing is done yet; then how much of the experiment that is, and the latencies compared."""
    lines = "".join(flowed(harmless(line), look) for line in notes(run.experiment, values, every=every))
    return table(rows(run.experiment, values, every=every), look) + "\n" + lines


def rows(experiment: Experiment, values: Sequence[Column], *, every: bool) -> list[Row]:
    """The head and a row per scheme; with ``every`` all metrics, each with its deviation. Trials are counted where some are missing."""
    planned = experiment.repetitions
    counted = every or any(value.runs < planned for value in values)
    metrics = _metrics(experiment, values, every=every)
    found: list[Row] = [("SCHEME", *(["TRIALS"] if counted else []), *(metric.head for metric in metrics))]
    for value in values:
        trials = [f"{value.runs}/{planned}"] if counted else []
        found.append((scheme(value), *trials, *(text_of(metric.figures(value), metric, spread=every) for metric in metrics)))
    return found


def _metrics(experiment: Experiment, values: Sequence[Column], *, every: bool) -> list[Metric]:
    common = (
        *usage(values),
        of_all("handoffs", "HANDOFFS", 1),
        of_all("downtime", "DOWNTIME s", 1),
        of_all("unplaced", "UNPLACED", 1),
    )
    own = [*(application(name, values) for name in experiment.metrics), *map(ssim, experiment.maps)]
    return [*(metric for metric in common if every or metric.name in _MAIN), *own]


def notes(experiment: Experiment, values: Sequence[Column], *, every: bool = False) -> Iterator[str]:
    """What stands below the table of the same ``every``."""
    done, planned = sum(value.runs for value in values), experiment.repetitions * len(values)
    hosts = next((value.hosts for value in values if value.hosts), ())
    by = f", by edge ({'/'.join(hosts)}; local: mean of the robots)" if hosts else ""
    yield f"{done} of {planned} trials of {experiment.name}; {numbers(every=every)}{by}."
    yield from given_up(values, "trials")
    yield from (f"{value.variant.name}: tasks without a host, over all plans: {value.unplaced}" for value in values if value.unplaced)
    yield from ratios(values)


def markdown(run: Run, values: Sequence[Column], escaped: Callable[[str], str] = harmless) -> str:
    """Everything as a table of Markdown."""
    head, *body = ([cell if isinstance(cell, str) else cell.text for cell in row] for row in rows(run.experiment, values, every=True))
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *([escaped(cell) for cell in row] for row in body)]
    table_text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    return table_text + "\n" + "".join(f"- {escaped(line)}\n" for line in notes(run.experiment, values, every=True))


def as_document(run: Run, values: Sequence[Column]) -> Document:
    """Every figure as JSON types. Latency in min, cpu, cpu peak and memory in percent, throughput in MB/s, downtime in s."""
    return {
        "format_version": FORMAT_VERSION,
        "experiment": run.experiment.name,
        "digest": run.digest,
        "planned": run.experiment.repetitions,
        "done": sum(value.runs for value in values),
        "schemes": [{**document(value), **applications(value)} for value in values],
    }
