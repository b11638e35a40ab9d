"""Gantt charts: a panel per scheme, a row per task, a bar per placement in the colour of the host."""

from collections.abc import Collection, Sequence
from math import ceil
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from edgectl.experiments.model.experiment import ExperimentRun, Trial
from edgectl.experiments.report.figure_style import (
    FIGURE_WIDTH_IN,
    INK,
    SMALL_TEXT_PT,
    ReportFigure,
    choose_time_unit,
    create_panels,
    estimate_text_width_in,
    label_x_axis,
    shorten_label,
)
from edgectl.experiments.report.trial_selection import get_median_trial, list_tried_schemes
from edgectl.names import natural_key

# Light enough for dark text, and as distinct in grey as possible; a bar that is long enough shows the host's
# name.
_HOST_COLOURS = (
    "#9ecae9",
    "#ffbf79",
    "#88d27a",
    "#e0e0e0",
    "#d6a5c9",
    "#f2cf5b",
    "#83bcb6",
    "#ff9d98",
    "#c9b29b",
    "#79a6d2",
    "#b8b04a",
    "#bab0ac",
)
_DARK_COLOUR = "#1a1a1a"
_MAX_CHARTS_PER_ROW, _ROW_HEIGHT_IN = 1, 0.135
_HANDOFF_MARKER: dict[str, Any] = {"linestyle": "none", "marker": "v", "markersize": 3.4, "color": INK}
_COMPLETED_MARKER: dict[str, Any] = {
    "linestyle": "none",
    "marker": "|",
    "markersize": 7.0,
    "markeredgewidth": 1.6,
    "color": INK,
}


def draw_gantt_charts(run: ExperimentRun) -> list[ReportFigure]:
    """The trial of median latency of each scheme; no figure if no task ever ran."""
    trials = [get_median_trial(run, scheme) for scheme in list_tried_schemes(run)]
    if not any(trial.spans for trial in trials):
        return []
    return [
        ReportFigure(
            name="gantt",
            title="Tasks over hosts",
            caption="Placement of each task in the trial of median latency of each scheme. The colour of a "
            "bar, and its label if there is room, is the host; a triangle marks the end of a handoff, a "
            "vertical line the completion of the task.",
            figure=_draw_gantt_figure(run, trials),
        )
    ]


def _draw_gantt_figure(run: ExperimentRun, trials: Sequence[Trial]) -> Figure:
    tasks = sorted({span.task for trial in trials for span in trial.spans}, key=natural_key)
    hosts = dict.fromkeys([*run.machines, *(span.host for trial in trials for span in trial.spans)])
    there = {span.host for trial in trials for span in trial.spans}
    colours = {
        host: _HOST_COLOURS[number % len(_HOST_COLOURS)] for number, host in enumerate(hosts) if host in there
    }
    end = (
        max(moment for trial in trials for moment in (trial.latency, *(span.end for span in trial.spans)))
        or 1.0
    )
    unit, word = choose_time_unit(run)
    across, legend = min(len(trials), _MAX_CHARTS_PER_ROW), _compute_legend_columns(colours)
    top = 0.3 + 0.14 * ceil((len(colours) + 2) / legend)
    left = estimate_text_width_in(map(shorten_label, tasks), SMALL_TEXT_PT) + 0.1
    figure, axes = create_panels(
        ceil(len(trials) / across),
        across,
        height=_ROW_HEIGHT_IN * max(len(tasks), 2),
        left=left,
        top=top,
        gap=(0.12, 0.24),
    )
    places = [panel for row in axes for panel in row]
    width = FIGURE_WIDTH_IN * axes[0][0].get_position().width
    for panel, trial in zip(places, trials, strict=False):
        _draw_gantt_panel(panel, trial, tasks, colours, unit, end / width)
        ending = "" if trial.finished else ", ended by the time limit"
        panel.set_title(
            f"{shorten_label(trial.scheme, 34)}: {trial.latency / unit:.3g} {word}{ending}", loc="left"
        )
    for panel in places[len(trials) :]:
        panel.remove()
    for panel in places[max(0, len(trials) - across) : len(trials)]:
        panel.tick_params(labelbottom=True)
    axes[0][0].set_xlim(0.0, 1.02 * end / unit)
    axes[0][0].xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 3, 5, 6, 10]))
    _draw_gantt_legend(figure, colours, legend)
    label_x_axis(figure, f"time since the start of the trial ({word})")
    return figure


def _draw_gantt_panel(
    panel: Axes, trial: Trial, tasks: Sequence[str], colours: dict[str, str], unit: float, per_inch: float
) -> None:
    """``per_inch``: time scale in s per inch."""
    row = {task: number for number, task in enumerate(tasks)}
    for span in trial.spans:
        long, colour = span.end - span.start, colours[span.host]
        panel.barh(
            row[span.task],
            long / unit,
            left=span.start / unit,
            height=0.78,
            color=colour,
            edgecolor=_DARK_COLOUR,
            linewidth=0.3,
        )
        if estimate_text_width_in([span.host], SMALL_TEXT_PT) < long / per_inch:
            middle = (span.start + span.end) / 2 / unit
            panel.text(
                middle,
                row[span.task],
                shorten_label(span.host),
                ha="center",
                va="center_baseline",
                fontsize=SMALL_TEXT_PT,
                color=_DARK_COLOUR,
                clip_on=True,
            )
    done = [(at, row[task]) for task, at in trial.completed.items() if task in row]
    panel.plot(
        [at / unit for at, _ in done], [place for _, place in done], clip_on=False, **_COMPLETED_MARKER
    )
    moved = [(handoff.at, row[handoff.task]) for handoff in trial.handoffs if handoff.task in row]
    panel.plot(
        [at / unit for at, _ in moved], [place - 0.33 for _, place in moved], clip_on=False, **_HANDOFF_MARKER
    )
    panel.set_ylim(len(tasks) - 0.45, -0.55)
    panel.set_yticks(range(len(tasks)), [shorten_label(task) for task in tasks])
    panel.tick_params(axis="y", length=0.0)
    panel.grid(visible=False, axis="y")


def _compute_legend_columns(names: Collection[str]) -> int:
    """Number of legend columns with about equally long rows."""
    fitting = max(
        1, int(FIGURE_WIDTH_IN / (estimate_text_width_in([*names, "completed"], SMALL_TEXT_PT) + 0.32))
    )
    return ceil((len(names) + 2) / ceil((len(names) + 2) / fitting))


def _draw_gantt_legend(figure: Figure, colours: dict[str, str], columns: int) -> None:
    """Draw the legend of colours and markers above all panels."""
    hosts = [
        Patch(facecolor=colour, edgecolor=_DARK_COLOUR, linewidth=0.3, label=shorten_label(host))
        for host, colour in colours.items()
    ]
    marks = [
        Line2D([], [], label="handoff", **_HANDOFF_MARKER),
        Line2D([], [], label="completed", **_COMPLETED_MARKER),
    ]
    figure.legend(
        handles=[*hosts, *marks],
        loc="upper left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        handlelength=1.2,
        columnspacing=1.4,
    )
