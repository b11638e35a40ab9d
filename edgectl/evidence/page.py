"""The report as one HTML page: everything inline, nothing fetched, no script. jinja2 escapes every value."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from statistics import median

from jinja2 import Environment, PackageLoader, StrictUndefined

from edgectl import __version__
from edgectl.evidence.trials import missing, trials_of
from edgectl.model.experiment import Handoff, Run
from edgectl.units import format_bytes, format_duration, format_instant


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure as an SVG element that may stand in a page, under the ``name`` of its place."""

    name: str
    title: str
    caption: str
    svg: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows of words, the first one the head, and sentences below."""

    rows: Sequence[Sequence[str]]
    notes: Sequence[str]


def page(run: Run, table: Table, pictures: Sequence[Picture]) -> str:
    """The page of a run with one trial at least."""
    environment = Environment(loader=PackageLoader("edgectl", "evidence"), autoescape=True, undefined=StrictUndefined)
    environment.filters |= {"instant": _instant, "bytes": format_bytes, "seconds": _seconds, "listed": _listed}
    return environment.get_template("page.html").render(
        run=run,
        version=__version__,
        planned=len(run.experiment.variants) * run.experiment.repetitions,
        began=_instant(min(trial.began_at for trial in run.trials)),
        ended=_instant(max(trial.began_at + trial.latency for trial in run.trials)),
        limit=format_duration(run.experiment.limit),
        every=format_duration(run.experiment.every),
        missing=missing(run),
        unfinished=[(trial.scheme, trial.repetition) for trial in run.trials if not trial.finished],
        table=list(zip(*table.rows, strict=True)),
        notes=table.notes,
        figures=pictures,
        moves=list(_moves(run)),
    )


def _listed(trials: Iterable[tuple[str, int]]) -> str:
    """Scheme by scheme, which of its trials."""
    grouped = groupby(trials, key=lambda trial: trial[0])
    return "; ".join(f"{scheme}: {', '.join(str(number) for _, number in each)}" for scheme, each in grouped)


def _moves(run: Run) -> Iterator[Mapping[str, object]]:
    """One row per scheme and task that changed its host."""
    for variant in run.experiment.variants:
        trials = trials_of(run, variant.name)
        handoffs = sorted((handoff for trial in trials for handoff in trial.handoffs), key=_task)
        for task, each in groupby(handoffs, key=_task):
            found = list(each)
            known = [handoff.downtime for handoff in found if handoff.downtime is not None]
            yield {
                "scheme": variant.name,
                "task": task,
                "count": len(found),
                "per_trial": f"{len(found) / len(trials):.1f}",
                "median": _seconds(median(known) if known else None),
                "greatest": _seconds(max(known, default=None)),
            }


def _instant(epoch_s: float) -> str:
    return format_instant(round(epoch_s))


def _task(handoff: Handoff) -> str:
    return handoff.task


def _seconds(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.1f}"
