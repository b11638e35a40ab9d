# SPDX-License-Identifier: Apache-2.0
"""Time series: a panel per scheme and host (or task), a line per trial and a thick one for the mean."""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from statistics import fmean

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from edgectl.experiments.model.experiment import ExperimentRun, HostCapacity, Trial
from edgectl.experiments.report.event_marks import (
    CAPTION,
    CAPTION_OF_MANY,
    draw_event_marks,
    draw_event_ticks,
    list_event_kinds,
)
from edgectl.experiments.report.figure_style import (
    ReportFigure,
    choose_time_unit,
    create_panels,
    estimate_text_width_in,
    get_scheme_colour,
    label_rows,
    label_x_axis,
    shorten_label,
    wrap_label,
)
from edgectl.experiments.report.trial_selection import list_tried_schemes, select_trials
from edgectl.experiments.scheme_results import MAX_METRIC_VALUE
from edgectl.names import natural_key

TimeSeries = Sequence[tuple[float, float]]  # (s after the start of the trial, value), by time
SeriesExtractor = Callable[[Trial, str], TimeSeries]
_MAX_PANELS_PER_ROW, _MAX_MEAN_STEPS = 3, 240
_CAPTION_LINES = (
    "Thin: each trial; thick: the mean of the trials still running, while at least half of them are."
)


def draw_loads(run: ExperimentRun) -> list[ReportFigure]:
    """CPU, memory and throughput of every host under every scheme."""
    hosts = [host for host in run.machines if any(trial.loads.get(host) for trial in run.trials)]
    busy = [
        host
        for host in hosts
        if any(load.bytes_per_s > 0 for trial in run.trials for load in trial.loads.get(host, ()))
    ]
    cores = {
        host: f"{shorten_label(host, 20)}\n{_format_core_count(run.machines[host].cores)}" for host in hosts
    }
    sizes = {
        host: f"{shorten_label(host, 20)}\n{run.machines[host].memory / 2**30:.3g} GiB" for host in hosts
    }
    plain = {host: shorten_label(host, 20) for host in busy}
    quiet = "" if len(busy) == len(hosts) else " Hosts without traffic are omitted."
    cpu, memory = _build_cpu_extractor(run.machines), _build_memory_extractor(run.machines)
    links = "Throughput on the links to the robots"
    return [
        *_draw_quantity(run, "cpu", "CPU utilisation", "% of the host's cores", cores, cpu, 100.0),
        *_draw_quantity(run, "memory", "Memory utilisation", "% of the host's memory", sizes, memory),
        *_draw_quantity(run, "throughput", links, "MB/s", plain, _extract_throughput, note=quiet),
    ]


def draw_readings(run: ExperimentRun) -> list[ReportFigure]:
    """Each application metric, by scheme and task."""
    names = dict.fromkeys(
        [*run.experiment.metrics, *(name for trial in run.trials for name in trial.readings)]
    )
    found = []
    for number, name in enumerate(names, 1):
        tasks = sorted(
            {task for trial in run.trials for task, rows in trial.readings.get(name, {}).items() if rows},
            key=natural_key,
        )
        heads = {task: wrap_label(task) for task in tasks}
        found += _draw_quantity(
            run,
            f"metric-{number}",
            f"Application metric {name}",
            name,
            heads,
            _build_reading_extractor(name),
            what="task",
        )
    return found


def _format_core_count(count: float) -> str:
    return f"{count:.3g} core" + ("" if count == 1 else "s")


def _build_cpu_extractor(machines: Mapping[str, HostCapacity]) -> SeriesExtractor:
    return lambda trial, host: [
        (load.at, 100 * load.cores / machines[host].cores) for load in trial.loads.get(host, ())
    ]


def _build_memory_extractor(machines: Mapping[str, HostCapacity]) -> SeriesExtractor:
    return lambda trial, host: [
        (load.at, 100 * load.memory / machines[host].memory) for load in trial.loads.get(host, ())
    ]


def _extract_throughput(trial: Trial, host: str) -> TimeSeries:
    return [(load.at, load.bytes_per_s / 1e6) for load in trial.loads.get(host, ())]


def _build_reading_extractor(name: str) -> SeriesExtractor:
    def read(trial: Trial, task: str) -> TimeSeries:
        found = trial.readings.get(name, {}).get(task, ())
        return [(reading.at, reading.value) for reading in found if abs(reading.value) < MAX_METRIC_VALUE]

    return read


def _draw_quantity(
    run: ExperimentRun,
    name: str,
    title: str,
    unit: str,
    heads: Mapping[str, str],
    read: SeriesExtractor,
    most: float = 0.0,
    *,
    what: str = "host",
    note: str = "",
) -> list[ReportFigure]:
    """The figures of one quantity, with at most three columns each.

    ``most``: smallest upper end of the value axis.
    """
    measure = "As written by the tasks" if what == "task" else f"In {unit}"
    marks = (CAPTION_OF_MANY if _has_many_trials(run) else CAPTION) if list_event_kinds(run.trials) else ""
    columns = list(heads)
    return [
        ReportFigure(
            name=f"{name}-{first // _MAX_PANELS_PER_ROW + 1}" if first else name,
            title=title,
            caption=f"{measure}, over the time since the start of the trial, by scheme (rows) and {what} "
            f"(columns). All panels have the same axes. {_CAPTION_LINES}{note}{marks}",
            figure=_draw_time_series_figure(
                run,
                {column: heads[column] for column in columns[first : first + _MAX_PANELS_PER_ROW]},
                read,
                unit,
                most,
            ),
        )
        for first in range(0, len(columns), _MAX_PANELS_PER_ROW)
    ]


def _draw_time_series_figure(
    run: ExperimentRun, heads: Mapping[str, str], read: SeriesExtractor, unit: str, most: float
) -> Figure:
    schemes = list_tried_schemes(run)
    left = (
        estimate_text_width_in(line for scheme in schemes for line in wrap_label(scheme).splitlines()) + 0.33
    )
    lines = max(head.count("\n") for head in heads.values()) + 1
    figure, axes = create_panels(
        len(schemes), len(heads), height=0.56, left=left, top=0.1 + 0.125 * max(lines, 2)
    )
    second, word = choose_time_unit(run)
    draw_events = draw_event_ticks if _has_many_trials(run) else draw_event_marks
    for scheme, row in zip(schemes, axes, strict=True):
        trials = select_trials(run, scheme)
        for column, panel in zip(heads, row, strict=True):
            lines_of_trials = [series for trial in trials if (series := sorted(read(trial, column)))]
            for trial in trials:
                draw_events(panel, trial.events, second)
            _draw_series_panel(
                panel, lines_of_trials, get_scheme_colour(run, scheme), second, run.experiment.every
            )
    for panel, head in zip(axes[0], heads.values(), strict=True):
        panel.set_title(head, linespacing=1.15)
    _scale_time_series_axes(axes[0][0], most)
    label_rows(figure, axes, schemes, unit)
    label_x_axis(figure, f"time since the start of the trial ({word})")
    return figure


def _has_many_trials(run: ExperimentRun) -> bool:
    """Whether a panel has the lines of more than one trial."""
    return any(len(select_trials(run, scheme)) > 1 for scheme in list_tried_schemes(run))


def _draw_series_panel(
    panel: Axes, trials: Sequence[TimeSeries], colour: str, second: float, every: float
) -> None:
    for series in trials:
        _draw_series_line(panel, series, second, colour, 0.5)
    _draw_series_line(panel, _compute_mean_series(trials, every), second, colour, 1.3)
    panel.label_outer()


def _draw_series_line(panel: Axes, series: TimeSeries, second: float, colour: str, width: float) -> None:
    """Draw a line, or a point for a single sample."""
    at, values = [each / second for each, _ in series], [value for _, value in series]
    panel.plot(
        at,
        values,
        color=colour,
        linewidth=width,
        alpha=0.55 if width < 1 else 1.0,
        marker="." if len(series) == 1 else "",
    )


def _scale_time_series_axes(panel: Axes, most: float) -> None:
    """Start at 0 unless values are negative; few, round ticks."""
    low, high = min(panel.get_ylim()[0], 0.0), max(panel.get_ylim()[1], most, 0.0)
    panel.set_ylim(1.06 * low, 1.06 * high if high > low else 1.0)
    panel.set_xlim(0.0, 1.02 * panel.get_xlim()[1])
    panel.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 3, 5, 6, 10]))
    panel.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))


def _compute_mean_series(trials: Sequence[TimeSeries], every: float) -> TimeSeries:
    """The mean over the trials with a value at a time, while at least half of them have one."""
    if len(trials) == 1:
        return trials[0]
    end = max((series[-1][0] for series in trials), default=0.0)
    step = max(every, end / _MAX_MEAN_STEPS)
    times = [step * number for number in range(round(end / step) + 1)]
    values = [
        (at, [value for series in trials if (value := _interpolate_at(series, at, step / 2)) is not None])
        for at in times
    ]
    return [(at, fmean(found)) for at, found in values if found and 2 * len(found) >= len(trials)]


def _interpolate_at(series: TimeSeries, at: float, near: float) -> float | None:
    """The linear interpolation at ``at``, or an end value within ``near`` s; None outside of the series."""
    after = bisect_right(series, at, key=lambda sample: sample[0])
    if after in (0, len(series)):
        end = series[0] if after == 0 else series[-1]
        return end[1] if abs(end[0] - at) <= near else None
    (since, before), (until, behind) = series[after - 1], series[after]
    return before + (behind - before) * (at - since) / (until - since)
