"""Ratios of the times of missions with their intervals: a row per comparison of two schemes."""

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from edgectl.experiments.model.comparison import Interval
from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.experiments.report.figure_style import (
    FAINT,
    GRID,
    ReportFigure,
    create_panels,
    estimate_text_width_in,
    get_scheme_colour,
    label_x_axis,
    shorten_label,
)
from edgectl.experiments.scheme_comparison import MISSION_TIME, compare_schemes
from edgectl.experiments.scheme_results import summarize_trials

_ROW_HEIGHT_IN = 0.2


def draw_ratios(run: ExperimentRun, bound: float | None) -> list[ReportFigure]:
    """The ratio of each comparison; no figure without a pair of trials.

    ``bound``: of equivalence, drawn as a band.
    """
    compared = [
        (each, each.ratio)
        for each in compare_schemes(summarize_trials(run), bound)
        if each.metric == MISSION_TIME and each.ratio is not None
    ]
    if not compared:
        return []
    names = [f"{shorten_label(each.scheme, 17)} / {shorten_label(each.base, 17)}" for each, _ in compared]
    figure, ((panel,),) = create_panels(
        1,
        1,
        height=_ROW_HEIGHT_IN * len(compared) + 0.1,
        left=estimate_text_width_in(names) + 0.15,
        top=0.08,
    )
    for row, (each, ratio) in enumerate(compared):
        _draw_interval(panel, row, ratio, get_scheme_colour(run, each.scheme))
    if bound is not None:
        panel.axvspan(1 / (1 + bound), 1 + bound, color=GRID, alpha=0.5, linewidth=0, zorder=0.0)
    panel.axvline(1.0, color=FAINT, linewidth=0.8)
    panel.set_ylim(len(compared) - 0.5, -0.5)
    panel.set_yticks(range(len(compared)), names)
    panel.grid(visible=False, axis="y")
    panel.tick_params(axis="y", length=0.0, pad=5.0)
    _scale_ratio_axis(panel, [ratio for _, ratio in compared], bound or 0.0)
    label_x_axis(figure, "ratio (below 1: sooner)")
    band = "" if bound is None else f" The band is the bound of equality, {100 * bound:g} %."
    return [
        ReportFigure(
            name="ratios",
            title="Time of the mission against other schemes",
            caption="Geometric mean of the ratio over pairs of the same repetition, with its 95 % interval "
            "(Student's t of the logarithms, before Holm). An interval that reaches 1 shows no difference; a "
            f"single pair has no interval.{band}",
            figure=figure,
        )
    ]


def _draw_interval(panel: Axes, row: int, ratio: Interval, colour: str) -> None:
    if ratio.low is not None and ratio.high is not None:
        panel.plot(
            [ratio.low, ratio.high], [row, row], color=colour, linewidth=1.2, marker="|", markersize=5.0
        )
    panel.plot(ratio.mean, row, "D", color=colour, markersize=3.4, clip_on=False, zorder=3.0)


def _scale_ratio_axis(panel: Axes, ratios: list[Interval], bound: float) -> None:
    ends = [value for each in ratios for value in (each.mean, each.low, each.high) if value is not None]
    low, high = min(*ends, 1 / (1 + bound), 0.95), max(*ends, 1 + bound, 1.05)
    room = 0.06 * (high - low)
    panel.set_xlim(low - room, high + room)
    panel.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
