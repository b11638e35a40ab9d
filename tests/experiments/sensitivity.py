# SPDX-License-Identifier: Apache-2.0
"""Table and figure of docs/evaluation/sensitivity.md, from the results of its sweep: ``make sensitivity``."""

import subprocess
import sys
from collections.abc import Mapping, Sequence
from io import BytesIO
from math import ceil, exp, log
from pathlib import Path
from statistics import fmean
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Rectangle

from edgectl.experiments.files.sweep_file import load_sweep
from edgectl.experiments.files.sweep_results import load_results
from edgectl.experiments.model.comparison import Interval
from edgectl.experiments.model.sweep import Sweep, SweepWorld, WorldResult
from edgectl.experiments.paired_tests import estimate_mean_interval
from edgectl.experiments.report.figure_style import FIGURE_WIDTH_IN, SMALL_TEXT_PT, TEXT_PT
from edgectl.experiments.scheme_results import compute_estimate

ROOT = Path(__file__).parents[2]
SPEC = ROOT / "docs" / "scenarios" / "sweep-sensitivity.yaml"
RESULTS = ROOT / "docs" / "evaluation" / "sensitivity"
PAGE = ROOT / "docs" / "evaluation" / "sensitivity.md"
FIGURE = ROOT / "docs" / "evaluation" / "sensitivity.svg"
MARKS = "<!-- begin of the table: make sensitivity -->\n", "<!-- end of the table -->\n"
# The simplest scheme whose mean time is at most this much above the least one is enough.
ALIKE = 0.02
LOCAL, STATIC, DYNAMIC = "local", "static", "utility all"
ENOUGH = {LOCAL: "local", STATIC: "static", DYNAMIC: "dynamic"}
MINUTE = 60.0
GRID_AXES = ("radio", "robot_cores", "link_ratio")


def load() -> tuple[Sweep, Mapping[str, WorldResult]]:
    """The sweep and its results."""
    sweep = load_sweep(SPEC)
    return sweep, load_results(sweep.worlds, [RESULTS], print)


def find_enough(result: WorldResult) -> str:
    """The simplest scheme that is enough: local before static before dynamic."""
    means = {name: compute_estimate(each.latency).mean for name, each in result.schemes.items()}
    least = min(means.values())
    return next(name for name in (LOCAL, STATIC, DYNAMIC) if means[name] <= least * (1 + ALIKE))


def compute_gain(result: WorldResult) -> Interval:
    """By which share of the better of local and static the dynamic scheme is faster, by pairs of the same seed
    (geometric mean of the ratios), with its 95 % interval; negative: slower.
    """
    better = min((LOCAL, STATIC), key=lambda name: fmean(result.schemes[name].latency))
    pairs = zip(result.schemes[DYNAMIC].latency, result.schemes[better].latency, strict=True)
    found = estimate_mean_interval([log(dynamic / other) for dynamic, other in pairs])
    low, high = (found.mean if each is None else each for each in (found.high, found.low))
    return Interval(mean=1.0 - exp(found.mean), low=1.0 - exp(low), high=1.0 - exp(high))


def is_in_grid(world: SweepWorld) -> bool:
    return set(world.settings) == set(GRID_AXES)


def render_table(sweep: Sweep, results: Mapping[str, WorldResult]) -> str:
    """A Markdown row for each world that is in no grid, and the grids."""
    grid = {
        tuple(world.settings[axis] for axis in GRID_AXES): results[world.digest]
        for world in sweep.worlds
        if is_in_grid(world)
    }
    radios, cores, ratios = (list(dict.fromkeys(key[place] for key in grid)) for place in range(3))
    lines = []
    for radio in radios:
        lines += [
            f"Radio: {radio}.",
            "",
            f"| cores of a robot | {' | '.join(f'1:{ratio}' for ratio in ratios)} |",
        ]
        lines.append("|---|" + "---|" * len(ratios))
        for core in cores:
            cells = (format_cell(grid[radio, core, ratio]) for ratio in ratios)
            lines.append(f"| {core} | {' | '.join(cells)} |")
        lines.append("")
    lines += [
        "| setting | local, min | static, min | utility all, min | enough | gain |",
        "|---|---|---|---|---|---|",
    ]
    for world in sweep.worlds:
        if not is_in_grid(world):
            result = results[world.digest]
            name = ", ".join(f"{key} {value}" for key, value in world.settings.items())
            times = " | ".join(_format_time(result, scheme) for scheme in (LOCAL, STATIC, DYNAMIC))
            lines.append(f"| {name} | {times} | {ENOUGH[find_enough(result)]} | {_format_gain(result)} |")
    return "\n".join(lines) + "\n"


def format_cell(result: WorldResult) -> str:
    """Which scheme is enough, and the gain of the dynamic one with its interval."""
    return f"{ENOUGH[find_enough(result)]} {_format_gain(result)}"


def _format_gain(result: WorldResult) -> str:
    gain = compute_gain(result)
    return f"{_format_percent(gain.mean)}% [{', '.join(map(_format_percent, (gain.low, gain.high)))}]"


def _format_percent(share: float | None) -> str:
    """Whole percents with their sign; 0 has none."""
    whole = round(100 * (share or 0.0))
    return f"{whole:+d}" if whole else "0"


def _format_time(result: WorldResult, scheme: str) -> str:
    estimate = compute_estimate(result.schemes[scheme].latency)
    return f"{estimate.mean / MINUTE:.1f}±{estimate.half_ci95 / MINUTE:.1f}"


def draw_figure(sweep: Sweep, results: Mapping[str, WorldResult]) -> bytes:
    """The grids as maps, and a panel for each other setting; SVG.

    As wide as the figures of a report, so that it can be read on a screen of 400 px.
    """
    style: dict[Any, Any] = dict.fromkeys(
        ("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), SMALL_TEXT_PT
    )
    with rc_context({**style, "svg.fonttype": "none", "svg.hashsalt": "edgectl", "font.size": TEXT_PT}):
        figure = Figure(figsize=(FIGURE_WIDTH_IN, 6.4), layout="constrained")
        halves = figure.add_gridspec(2, 1, height_ratios=(5, 4))
        _draw_maps(figure.add_subfigure(halves[0]), sweep, results)
        _draw_lines(figure.add_subfigure(halves[1]), sweep, results)
        data = BytesIO()
        figure.savefig(data, format="svg", metadata={"Date": None, "Creator": None})
    return data.getvalue()


# Those of the same schemes in the figures of docs/evaluation.md.
COLOURS = {LOCAL: "#767676", STATIC: "#0072b2", DYNAMIC: "#009e73"}


def _draw_maps(figure: SubFigure, sweep: Sweep, results: Mapping[str, WorldResult]) -> None:
    worlds = [world for world in sweep.worlds if is_in_grid(world)]
    radios = list(dict.fromkeys(world.settings["radio"] for world in worlds))
    for axes, radio in zip(figure.subplots(len(radios), 1, sharex=True), radios, strict=True):
        here = [world for world in worlds if world.settings["radio"] == radio]
        ratios, cores = (
            list(dict.fromkeys(world.settings[key] for world in here))
            for key in ("link_ratio", "robot_cores")
        )
        for world in here:
            x, y = ratios.index(world.settings["link_ratio"]), cores.index(world.settings["robot_cores"])
            result = results[world.digest]
            axes.add_patch(_build_square(x, y, COLOURS[find_enough(result)]))
            gain = compute_gain(result)
            low, high = (_format_percent(each) for each in (gain.low, gain.high))
            for text, height, size in (
                (f"{_format_percent(gain.mean)}%", y + 0.17, TEXT_PT),
                (f"{low} .. {high}", y - 0.26, SMALL_TEXT_PT),
            ):
                axes.text(x, height, text, ha="center", va="center", color="white", fontsize=size)
        axes.set(
            xlim=(-0.5, len(ratios) - 0.5), ylim=(-0.5, len(cores) - 0.5),
            xticks=range(len(ratios)), xticklabels=[f"1:{ratio}" for ratio in ratios],
            yticks=range(len(cores)), yticklabels=cores, ylabel="cores of a robot",
        )  # fmt: skip
        axes.set_title(f"radio: {radio}", fontsize=TEXT_PT)
    figure.axes[-1].set_xlabel("far link to near link")
    figure.legend(
        handles=[_build_square(0, 0, colour) for colour in COLOURS.values()],
        labels=["local is best or as good", "static is enough", "dynamic wins"],
        loc="outside upper center", ncols=2, frameon=False,
    )  # fmt: skip


def _build_square(x: float, y: float, colour: str) -> Rectangle:
    return Rectangle((x - 0.48, y - 0.48), 0.96, 0.96, facecolor=colour, edgecolor="none")


def _draw_lines(figure: SubFigure, sweep: Sweep, results: Mapping[str, WorldResult]) -> None:
    names = [axis for axis in sweep.axes if axis not in GRID_AXES]
    panels = figure.subplots(ceil(len(names) / 2), 2, sharey=True).flat
    for axes, name in zip(panels, names, strict=False):
        worlds = [world for world in sweep.worlds if set(world.settings) == {name}]
        for scheme, colour in COLOURS.items():
            found = [compute_estimate(results[world.digest].schemes[scheme].latency) for world in worlds]
            axes.errorbar(
                range(len(worlds)), [each.mean / MINUTE for each in found],
                yerr=[each.half_ci95 / MINUTE for each in found],
                color=colour, marker="o", markersize=3, linewidth=1.2, capsize=2,
            )  # fmt: skip
        axes.set(
            xticks=range(len(worlds)), xticklabels=[world.settings[name] for world in worlds], xlabel=name
        )
        axes.set_ylim(bottom=0)
        axes.spines[["top", "right"]].set_visible(False)
    figure.supylabel("mission time, min", fontsize=TEXT_PT)


def replace_table(page: str, table: str) -> str:
    """The page with another table between its marks."""
    head, _, rest = page.partition(MARKS[0])
    return f"{head}{MARKS[0]}\n{table}\n{MARKS[1]}{rest.partition(MARKS[1])[2]}"


def main(argv: Sequence[str]) -> int:
    """Simulate what is missing, then write table and figure."""
    command = [sys.executable, "-m", "edgectl", "simulate", "sweep", str(SPEC), "--out", str(RESULTS), *argv]
    subprocess.run(command, check=True)
    sweep, results = load()
    PAGE.write_text(replace_table(PAGE.read_text(), render_table(sweep, results)))
    FIGURE.write_bytes(draw_figure(sweep, results))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
