"""Distributions by scheme: values, median, and quartiles and range if there are enough values."""

from collections.abc import Callable, Mapping, Sequence
from math import ceil
from statistics import median, quantiles
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from edgectl.experiments.model.comparison import Interval
from edgectl.experiments.model.experiment import ExperimentRun, Trial
from edgectl.experiments.paired_tests import estimate_mean_interval
from edgectl.experiments.report.figure_style import (
    INK,
    ReportFigure,
    choose_time_unit,
    create_panels,
    estimate_text_width_in,
    get_scheme_colour,
    label_x_axis,
    shorten_label,
)
from edgectl.experiments.report.trial_selection import list_tried_schemes, select_trials
from edgectl.names import natural_key

_MIN_BOX_VALUES = 4  # values, for quartiles
_MEAN_SHIFT = 0.4  # rows below the points
_MAX_PLOTS_PER_ROW = 2
_CAPTION_MARKS = (
    "Each point is one value, the vertical bar is the median; from four values on, the box spans the "
    "quartiles and the line the range. The diamond below is the mean with its 95 % interval."
)


class _PlotPoint(NamedTuple):
    value: float
    hollow: bool = False


PointExtractor = Callable[[Trial], Sequence[_PlotPoint]]


def draw_latency(run: ExperimentRun) -> ReportFigure:
    """Latency of the mission."""
    unit, word = _choose_latency_unit(run)
    panel = {"": lambda trial: [_PlotPoint(trial.latency / unit, not trial.finished)]}
    return ReportFigure(
        name="latency",
        title="Latency of the mission",
        caption=f"From the first plan to the completion of the last of {', '.join(run.experiment.until)}, "
        f"one value per trial. {_CAPTION_MARKS} A hollow point is a trial ended by the time limit.",
        figure=_draw_distribution_figure(run, panel, f"latency of the mission ({word})"),
    )


def draw_completions(run: ExperimentRun) -> list[ReportFigure]:
    """Completion time of each task; no figure if none completed."""
    unit, word = _choose_latency_unit(run)
    tasks = sorted({task for trial in run.trials for task in trial.completed}, key=natural_key)
    if not tasks:
        return []
    return [
        ReportFigure(
            name="tasks",
            title="Completion of each task",
            caption=f"From the start of the trial, one value per trial. {_CAPTION_MARKS}",
            figure=_draw_distribution_figure(
                run,
                {task: _build_completion_extractor(task, unit) for task in tasks},
                f"time since the start of the trial ({word})",
            ),
        )
    ]


def draw_handoffs(run: ExperimentRun) -> list[ReportFigure]:
    """Number of handoffs and their downtime; no figure without handoffs."""
    every = [handoff for trial in run.trials for handoff in trial.handoffs]
    if not every:
        return []
    known = any(handoff.downtime is not None for handoff in every)
    kinds: dict[str, PointExtractor] = {"handoffs per trial": lambda trial: [_PlotPoint(len(trial.handoffs))]}
    if known:
        kinds["downtime of a handoff (s)"] = lambda trial: [
            _PlotPoint(each.downtime) for each in trial.handoffs if each.downtime is not None
        ]
    return [
        ReportFigure(
            name="handoffs",
            title="Handoffs and their downtime" if known else "Handoffs",
            caption="Handoffs per trial"
            + (", and the downtime of each" if known else "")
            + f". {_CAPTION_MARKS}",
            figure=_draw_distribution_figure(run, kinds, ""),
        )
    ]


def _choose_latency_unit(run: ExperimentRun) -> tuple[float, str]:
    return choose_time_unit(run)


def _build_completion_extractor(task: str, unit: float) -> PointExtractor:
    return lambda trial: [_PlotPoint(trial.completed[task] / unit)] if task in trial.completed else []


def _draw_distribution_figure(run: ExperimentRun, kinds: Mapping[str, PointExtractor], label: str) -> Figure:
    """One panel per kind, with a row per scheme.

    With a ``label``, panels share the x axis; otherwise each has its own.
    """
    schemes = list_tried_schemes(run)
    # Panels with an axis of their own stand below each other: their labels are long.
    down = ceil(len(kinds) / (_MAX_PLOTS_PER_ROW if label else 1))
    across = ceil(len(kinds) / down)
    titled = bool(label) and "" not in kinds
    figure, axes = create_panels(
        down,
        across,
        height=0.26 * len(schemes) + 0.1,
        left=estimate_text_width_in(map(shorten_label, schemes)) + 0.2,
        top=0.24 if titled else 0.08,
        gap=(0.16, 0.32 if titled else 0.4),
        x=bool(label),
    )
    places = [panel for row in axes for panel in row]
    for panel, (kind, read) in zip(places, kinds.items(), strict=False):
        for row, scheme in enumerate(schemes):
            _draw_scheme_row(
                panel,
                row,
                [point for trial in select_trials(run, scheme) for point in read(trial)],
                get_scheme_colour(run, scheme),
            )
        panel.set_title(shorten_label(kind, 32) if titled else "", loc="left")
        panel.set_xlabel("" if label else kind)
        _scale_value_axis(panel, schemes)
    for panel in places[len(kinds) :]:
        panel.remove()
    for panel in places[max(0, len(kinds) - across) : len(kinds)]:
        panel.tick_params(labelbottom=True)
    label_x_axis(figure, label)
    return figure


def _draw_scheme_row(panel: Axes, row: int, points: Sequence[_PlotPoint], colour: str) -> None:
    """One scheme; points are shifted vertically, so that equal values stay visible."""
    values = [point.value for point in points]
    if len(values) >= _MIN_BOX_VALUES:
        low, _, high = quantiles(values, n=4, method="inclusive")
        panel.hlines(row, min(values), max(values), color=colour, linewidth=0.6)
        panel.barh(row, high - low, left=low, height=0.56, color=colour, alpha=0.25, linewidth=0)
    if values:
        panel.vlines(median(values), row - 0.3, row + 0.3, color=colour, linewidth=1.6, clip_on=False)
    if len(values) > 1:
        _draw_mean_interval(panel, row + _MEAN_SHIFT, estimate_mean_interval(values))
    for place, point in enumerate(points):
        shift = 0.5 * ((place * 0.381966) % 1 - 0.5) if len(points) > 1 else 0.0
        fill = "none" if point.hollow else "full"
        panel.plot(
            point.value,
            row + shift,
            "o",
            color=colour,
            fillstyle=fill,
            markersize=3.0,
            markeredgewidth=0.7,
            clip_on=False,
            zorder=3.0,
        )


def _draw_mean_interval(panel: Axes, row: float, mean: Interval) -> None:
    """The mean, and its interval with caps where there is one; both in the colour of the text."""
    if mean.low is not None and mean.high is not None:
        panel.plot([mean.low, mean.high], [row, row], color=INK, linewidth=0.8, marker="|", markersize=3.5)
    panel.plot(mean.mean, row, "D", color=INK, markersize=2.4, clip_on=False, zorder=3.0)


def _scale_value_axis(panel: Axes, schemes: Sequence[str]) -> None:
    panel.set_ylim(len(schemes) - 0.5, -0.5)
    panel.set_yticks(range(len(schemes)), [shorten_label(scheme) for scheme in schemes])
    panel.set_xlim(0.0, 1.04 * panel.get_xlim()[1] or 1.0)
    panel.xaxis.set_major_locator(MaxNLocator(5, integer=panel.get_xlim()[1] >= 5, steps=[1, 2, 3, 5, 6, 10]))
    panel.grid(visible=False, axis="y")
    panel.tick_params(axis="y", length=0.0, pad=5.0)
