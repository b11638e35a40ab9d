"""Distributions by scheme: every value a point, and their median; quartiles and the whole range where there are enough values."""

from collections.abc import Callable, Mapping, Sequence
from math import ceil
from statistics import median, quantiles
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from edgectl.evidence.drawing_sheet import Drawing, below, breadth, clock, colour_of, panels, shortened
from edgectl.evidence.trials import trials_of, tried
from edgectl.model.experiment import Run, Trial
from edgectl.model.order import natural_key

_ENOUGH = 4  # values, for quartiles
_ACROSS = 4
_MARKS = "Each point is one value, the upright bar their median; from four values on the box spans the quartiles and the line all values."


class _Point(NamedTuple):
    value: float
    hollow: bool = False


Read = Callable[[Trial], Sequence[_Point]]


def latency(run: Run) -> Drawing:
    """The latency of the mission."""
    unit, word = _clock(run)
    panel = {"": lambda trial: [_Point(trial.latency / unit, not trial.finished)]}
    return Drawing(
        name="latency",
        title="Latency of the mission",
        caption=f"From the first plan to the completion of the last of "
        f"{', '.join(run.experiment.until)}, one value per trial. {_MARKS} A hollow point is a trial that the limit ended.",
        figure=_figure(run, panel, f"latency of the mission ({word})"),
    )


def completions(run: Run) -> list[Drawing]:
    """When each task completed; nothing where none did."""
    unit, word = _clock(run)
    tasks = sorted({task for trial in run.trials for task in trial.completed}, key=natural_key)
    if not tasks:
        return []
    return [
        Drawing(
            name="tasks",
            title="Completion of each task",
            caption=f"From the beginning of the trial, one value per trial. {_MARKS}",
            figure=_figure(run, {task: _completed(task, unit) for task in tasks}, f"time since the trial began ({word})"),
        )
    ]


def handoffs(run: Run) -> list[Drawing]:
    """How often tasks changed their host, and how long they were down; nothing where none did."""
    every = [handoff for trial in run.trials for handoff in trial.handoffs]
    if not every:
        return []
    known = any(handoff.downtime is not None for handoff in every)
    kinds: dict[str, Read] = {"handoffs per trial": lambda trial: [_Point(len(trial.handoffs))]}
    if known:
        kinds["downtime of a handoff (s)"] = lambda trial: [_Point(each.downtime) for each in trial.handoffs if each.downtime is not None]
    return [
        Drawing(
            name="handoffs",
            title="Handoffs and their downtime" if known else "Handoffs",
            caption="How many a trial had" + (", and how long the task of each was down" if known else "") + f". {_MARKS}",
            figure=_figure(run, kinds, ""),
        )
    ]


def _clock(run: Run) -> tuple[float, str]:
    return clock(max(trial.latency for trial in run.trials))


def _completed(task: str, unit: float) -> Read:
    return lambda trial: [_Point(trial.completed[task] / unit)] if task in trial.completed else []


def _figure(run: Run, kinds: Mapping[str, Read], label: str) -> Figure:
    """One panel per kind, with a row per scheme. With a ``label`` all share their x axis; without, each is named below by its kind."""
    schemes = tried(run)
    down = ceil(len(kinds) / _ACROSS)
    across = ceil(len(kinds) / down)
    titled = bool(label) and "" not in kinds
    figure, axes = panels(
        down, across, height=0.19 * len(schemes) + 0.1, left=breadth(map(shortened, schemes)) + 0.2,
        top=0.24 if titled else 0.08, gap=(0.16, 0.32 if titled else 0.12), x=bool(label),
    )  # fmt: skip
    places = [panel for row in axes for panel in row]
    for panel, (kind, read) in zip(places, kinds.items(), strict=False):
        for row, scheme in enumerate(schemes):
            _row(panel, row, [point for trial in trials_of(run, scheme) for point in read(trial)], colour_of(run, scheme))
        panel.set_title(shortened(kind, 32) if titled else "", loc="left")
        panel.set_xlabel("" if label else kind)
        _scale(panel, schemes)
    for panel in places[len(kinds) :]:
        panel.remove()
    for panel in places[max(0, len(kinds) - across) : len(kinds)]:
        panel.tick_params(labelbottom=True)
    below(figure, label)
    return figure


def _row(panel: Axes, row: int, points: Sequence[_Point], colour: str) -> None:
    """One scheme: points a little above and below each other, so that equal ones do not hide."""
    values = [point.value for point in points]
    if len(values) >= _ENOUGH:
        low, _, high = quantiles(values, n=4, method="inclusive")
        panel.hlines(row, min(values), max(values), color=colour, linewidth=0.6)
        panel.barh(row, high - low, left=low, height=0.62, color=colour, alpha=0.25, linewidth=0)
    if values:
        panel.vlines(median(values), row - 0.36, row + 0.36, color=colour, linewidth=1.6, clip_on=False)
    for place, point in enumerate(points):
        aside = 0.5 * ((place * 0.381966) % 1 - 0.5) if len(points) > 1 else 0.0
        full = "none" if point.hollow else "full"
        panel.plot(
            point.value, row + aside, "o", color=colour, fillstyle=full, markersize=3.0, markeredgewidth=0.7, clip_on=False, zorder=3.0
        )  # fmt: skip


def _scale(panel: Axes, schemes: Sequence[str]) -> None:
    panel.set_ylim(len(schemes) - 0.5, -0.5)
    panel.set_yticks(range(len(schemes)), [shortened(scheme) for scheme in schemes])
    panel.set_xlim(0.0, 1.04 * panel.get_xlim()[1] or 1.0)
    panel.xaxis.set_major_locator(MaxNLocator(5, integer=panel.get_xlim()[1] >= 5, steps=[1, 2, 3, 5, 6, 10]))
    panel.grid(visible=False, axis="y")
    panel.tick_params(axis="y", length=0.0, pad=5.0)
