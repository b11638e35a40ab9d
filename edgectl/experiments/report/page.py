"""The report as a self-contained HTML page without scripts. jinja2 escapes all values."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from statistics import median

from jinja2 import Environment, PackageLoader, StrictUndefined

from edgectl import __version__
from edgectl.experiments.model.experiment import ExperimentRun, HandoffRecord
from edgectl.experiments.report.trial_selection import is_mission_short, list_missing_trials, select_trials
from edgectl.units import format_bytes, format_duration, format_instant


@dataclass(frozen=True, slots=True, kw_only=True)
class EmbeddedFigure:
    """A figure as an inline SVG element; ``name``: its anchor in the page."""

    name: str
    title: str
    caption: str
    svg: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportTable:
    """Rows of cells, the first one the heading, and the notes below.

    ``answer``: the sentence that opens the page. ``compared``: rows of the comparisons; empty without any.
    """

    rows: Sequence[Sequence[str]]
    notes: Sequence[str]
    answer: str
    compared: Sequence[Sequence[str]] = ()


def render_report_page(run: ExperimentRun, table: ReportTable, figures: Sequence[EmbeddedFigure]) -> str:
    """The page of a run, which needs a trial."""
    environment = Environment(
        loader=PackageLoader("edgectl", "experiments/report"), autoescape=True, undefined=StrictUndefined
    )
    environment.filters |= {
        "mission_time": _format_seconds_of_mission if is_mission_short(run) else _format_minutes_of_mission,
        "instant": _format_epoch,
        "bytes": format_bytes,
        "seconds": _format_measured_seconds,
        "listed": _format_trials_by_scheme,
    }
    return environment.get_template("page.html").render(
        run=run,
        version=__version__,
        planned=len(run.experiment.schemes) * run.experiment.repetitions,
        began=_format_epoch(min(trial.began_at for trial in run.trials)),
        ended=_format_epoch(max(trial.began_at + trial.latency for trial in run.trials)),
        limit=format_duration(run.experiment.limit),
        every=format_duration(run.experiment.every),
        missing=list_missing_trials(run),
        unfinished=[(trial.scheme, trial.repetition) for trial in run.trials if not trial.finished],
        table=list(zip(*table.rows, strict=True)),
        notes=table.notes,
        time_word="s" if is_mission_short(run) else "min",
        answer=table.answer,
        compared=table.compared,
        figures=figures,
        moves=list(_build_handoff_rows(run)),
    )


def _format_trials_by_scheme(trials: Iterable[tuple[str, int]]) -> str:
    """Repetitions by scheme: ``local: 1, 2; static: 3``."""
    grouped = groupby(trials, key=lambda trial: trial[0])
    return "; ".join(f"{scheme}: {', '.join(str(number) for _, number in each)}" for scheme, each in grouped)


def _build_handoff_rows(run: ExperimentRun) -> Iterator[Mapping[str, object]]:
    """One row per scheme and task that moved."""
    for scheme in run.experiment.schemes:
        trials = select_trials(run, scheme.name)
        handoffs = sorted((handoff for trial in trials for handoff in trial.handoffs), key=_get_handoff_task)
        for task, each in groupby(handoffs, key=_get_handoff_task):
            found = list(each)
            known = [handoff.downtime for handoff in found if handoff.downtime is not None]
            yield {
                "scheme": scheme.name,
                "task": task,
                "count": len(found),
                "per_trial": f"{len(found) / len(trials):.1f}",
                "median": _format_measured_seconds(median(known) if known else None),
                "greatest": _format_measured_seconds(max(known, default=None)),
            }


def _format_epoch(epoch_s: float) -> str:
    return format_instant(round(epoch_s))


def _format_seconds_of_mission(seconds: float) -> str:
    return f"{seconds:.1f}"


def _format_minutes_of_mission(seconds: float) -> str:
    return f"{seconds / 60:.2f}"


def _get_handoff_task(handoff: HandoffRecord) -> str:
    return handoff.task


def _format_measured_seconds(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.1f}"
