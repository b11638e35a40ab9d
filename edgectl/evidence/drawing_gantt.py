"""Which task was where and when: one panel per scheme, a row per task, a bar per stay in the colour of its host."""

from collections.abc import Collection, Sequence
from math import ceil
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from edgectl.evidence.drawing_sheet import INK, SMALL, WIDTH, Drawing, below, breadth, clock, panels, shortened
from edgectl.evidence.trials import tried, typical
from edgectl.model.experiment import Run, Trial
from edgectl.model.order import natural_key

# Light enough for dark words, and unlike each other in grey as far as it goes; where a bar is long enough, it bears its host's name.
_HOSTS = (
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
_DARK = "#1a1a1a"
_ACROSS, _ROW = 2, 0.135
_HANDOFF: dict[str, Any] = {"linestyle": "none", "marker": "v", "markersize": 3.4, "color": INK}
_COMPLETED: dict[str, Any] = {"linestyle": "none", "marker": "|", "markersize": 7.0, "markeredgewidth": 1.6, "color": INK}


def gantt(run: Run) -> list[Drawing]:
    """The typical trial of every scheme; nothing where no task ever ran."""
    trials = [typical(run, scheme) for scheme in tried(run)]
    if not any(trial.spans for trial in trials):
        return []
    return [
        Drawing(
            name="gantt",
            title="Tasks over hosts",
            caption="Where each task was, in the trial of median latency of each scheme. The colour of a bar, and the word in it where "
            "there is room, is the host; a triangle marks the end of a handoff, an upright line the completion of the task.",
            figure=_figure(run, trials),
        )
    ]


def _figure(run: Run, trials: Sequence[Trial]) -> Figure:
    tasks = sorted({span.task for trial in trials for span in trial.spans}, key=natural_key)
    hosts = dict.fromkeys([*run.machines, *(span.host for trial in trials for span in trial.spans)])
    there = {span.host for trial in trials for span in trial.spans}
    colours = {host: _HOSTS[number % len(_HOSTS)] for number, host in enumerate(hosts) if host in there}
    end = max(moment for trial in trials for moment in (trial.latency, *(span.end for span in trial.spans))) or 1.0
    unit, word = clock(end)
    across, legend = min(len(trials), _ACROSS), _legend(colours)
    top = 0.3 + 0.14 * ceil((len(colours) + 2) / legend)
    left = breadth(map(shortened, tasks), SMALL) + 0.1
    figure, axes = panels(ceil(len(trials) / across), across, height=_ROW * max(len(tasks), 2), left=left, top=top, gap=(0.12, 0.24))
    places = [panel for row in axes for panel in row]
    width = WIDTH * axes[0][0].get_position().width
    for panel, trial in zip(places, trials, strict=False):
        _panel(panel, trial, tasks, colours, unit, end / width)
        over = "" if trial.finished else ", ended by the limit"
        panel.set_title(f"{shortened(trial.scheme, 34)}: {trial.latency / unit:.3g} {word}{over}", loc="left")
    for panel in places[len(trials) :]:
        panel.remove()
    for panel in places[max(0, len(trials) - across) : len(trials)]:
        panel.tick_params(labelbottom=True)
    axes[0][0].set_xlim(0.0, 1.02 * end / unit)
    axes[0][0].xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 3, 5, 6, 10]))
    _key(figure, colours, legend)
    below(figure, f"time since the trial began ({word})")
    return figure


def _panel(panel: Axes, trial: Trial, tasks: Sequence[str], colours: dict[str, str], unit: float, per_inch: float) -> None:
    """``per_inch``: s that one inch of the panel shows."""
    row = {task: number for number, task in enumerate(tasks)}
    for span in trial.spans:
        long, colour = span.end - span.start, colours[span.host]
        panel.barh(row[span.task], long / unit, left=span.start / unit, height=0.78, color=colour, edgecolor=_DARK, linewidth=0.3)
        if breadth([span.host], SMALL) < long / per_inch:
            middle = (span.start + span.end) / 2 / unit
            panel.text(
                middle, row[span.task], shortened(span.host), ha="center", va="center_baseline", fontsize=SMALL, color=_DARK, clip_on=True
            )
    done = [(at, row[task]) for task, at in trial.completed.items() if task in row]
    panel.plot([at / unit for at, _ in done], [place for _, place in done], clip_on=False, **_COMPLETED)
    moved = [(handoff.at, row[handoff.task]) for handoff in trial.handoffs if handoff.task in row]
    panel.plot([at / unit for at, _ in moved], [place - 0.33 for _, place in moved], clip_on=False, **_HANDOFF)
    panel.set_ylim(len(tasks) - 0.45, -0.55)
    panel.set_yticks(range(len(tasks)), [shortened(task) for task in tasks])
    panel.tick_params(axis="y", length=0.0)
    panel.grid(visible=False, axis="y")


def _legend(names: Collection[str]) -> int:
    """Columns of the key, such that its rows are about equally long."""
    fitting = max(1, int(WIDTH / (breadth([*names, "completed"], SMALL) + 0.32)))
    return ceil((len(names) + 2) / ceil((len(names) + 2) / fitting))


def _key(figure: Figure, colours: dict[str, str], columns: int) -> None:
    """What colours and marks mean, above all panels."""
    hosts = [Patch(facecolor=colour, edgecolor=_DARK, linewidth=0.3, label=shortened(host)) for host, colour in colours.items()]
    marks = [Line2D([], [], label="handoff", **_HANDOFF), Line2D([], [], label="completed", **_COMPLETED)]
    figure.legend(
        handles=[*hosts, *marks],
        loc="upper left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        handlelength=1.2,
        columnspacing=1.4,
    )
