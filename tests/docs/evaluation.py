# SPDX-License-Identifier: Apache-2.0
"""``make evaluation``: the tables and the figures of docs/evaluation.md from the run that is committed.

    python -m tests.docs.evaluation [--run runs/patrol]

Takes over a complete run from --run where there is one, as docs/experiment; draws the figures of the page; and writes
the output of each exact block and each part between ``<!-- from the run: NAME -->`` and ``<!-- end -->`` anew.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.model.comparison import SchemeResult
from edgectl.experiments.model.experiment import ExperimentRun, Trial
from edgectl.experiments.scheme_comparison import MISSION_TIME, compare_schemes
from edgectl.experiments.scheme_results import compute_estimate, summarize_trials
from edgectl.experiments.views.answer import describe_answer
from tests.docs.blocks import environment
from tests.docs.tables import render_table
from tests.experiments.cycle_times import PILOT, render_times
from tests.experiments.deviations import (
    RUNS,
    render_local,
    render_pictures,
    render_recoveries,
    render_starts,
)
from tests.experiments.edge_pictures import render_edges
from tests.experiments.lab.disturbances import (
    ASIDE,
    BUSY_CORES,
    COUNTED,
    explain_disturbance,
    list_set_aside,
    measure_repetition,
)
from tests.experiments.lab.machine import FILE_NAME, MachineSample, load_samples
from tests.experiments.sensitivity import load as load_sensitivity
from tests.experiments.whereabouts import SEEDS, render_model, render_whereabouts

ROOT = Path(__file__).parents[2]
PAGE, RUN, FIGURES = ROOT / "docs" / "evaluation.md", ROOT / "docs" / "experiment", ROOT / "docs" / "figures"
DRAWN = ("latency.svg", "cpu.svg", "gantt.svg", "metric-1.svg")
# Of the plan: utility all against this scheme.
HYPOTHESES = {"H1, primary": "static", "H2": "local", "H3": "least-loaded"}
_PART = re.compile(r"(<!-- from the run: (\w+) -->\n).*?(<!-- end -->\n)", re.DOTALL)
_MODEL = re.compile(r"(<!-- from the model -->\n).*?(<!-- end -->\n)", re.DOTALL)
_MODEL_PART = re.compile(r"(<!-- from the model: ([\w ]+) -->\n).*?(<!-- end -->\n)", re.DOTALL)
# The world of the sensitivity that is the scenario as it is shipped.
SHIPPED = {"radio": "separate", "robot_cores": "1", "link_ratio": "10"}
_EXACT = re.compile(r"(<!-- exact -->\n```console\n)(.*?)(^```$)", re.MULTILINE | re.DOTALL)


def write_parts(text: str, directory: Path) -> str:
    """The page with the parts that state figures of the run in this directory."""
    run, status = load_run(directory), describe_status(directory)
    return _PART.sub(
        lambda part: part[1] + (status if part[2] == "status" else PARTS[part[2]](run)) + part[3], text
    )


def write_model(text: str) -> str:
    """The page with what the model of the patrol says now of where tasks stand."""
    return _MODEL.sub(lambda part: part[1] + render_model(SEEDS) + part[2], text)


def write_model_parts(text: str, *names: str) -> str:
    """The page with those parts of `MODEL_PARTS`, measured and in the model."""
    run = load_run(RUN)
    return _MODEL_PART.sub(
        lambda part: part[1] + MODEL_PARTS[part[2]](run) + part[3] if part[2] in names else part[0], text
    )


def render_changing_links() -> str:
    """Mission time in min and handoffs by scheme, of the world that the scenario is as it is shipped."""
    sweep, results = load_sensitivity()
    world = next(each for each in sweep.worlds if each.settings == SHIPPED)
    lines = ["| scheme | latency min | handoffs |\n", "|---|---:|---:|\n"]
    for name, found in results[world.digest].schemes.items():
        time, moves = compute_estimate(found.latency), compute_estimate(found.handoffs).mean
        lines.append(f"| {name} | {time.mean / 60:.1f}±{time.half_ci95 / 60:.1f} | {moves:.1f} |\n")
    return "".join(lines)


def describe_status(directory: Path) -> str:
    """How many trials there are, of when, whether they count as evidence, and what has disturbed them."""
    return write_status(load_run(directory), load_samples(directory / FILE_NAME), list_set_aside(directory))


def write_status(run: ExperimentRun, samples: Sequence[MachineSample], aside: Sequence[str]) -> str:
    """The same, of a run with these samples of the machine, after what was set ``aside``."""
    complete = min(sum(trial.scheme == each.name for trial in run.trials) for each in run.experiment.schemes)
    first = datetime.fromtimestamp(min(trial.began_at for trial in run.trials), UTC).date().isoformat()
    what = f"{len(run.trials)} trials of {first}, {complete} of each scheme"
    disturbed = list(find_disturbances(run, samples))
    lines = [describe_machine(run, samples)]
    for words, found in (("To be repeated", disturbed), ("Set aside and run again", aside)):
        lines += [f"{words}: {'. '.join(found)}."] if found else []
    load = "".join(f"{line}\n" for line in lines)
    if complete >= COUNTED and not disturbed:
        return f"The run: {what}.\n{load}"
    asked = f"the [plan](evaluation/plan.md) asks for {COUNTED}"
    return (
        f"**This run does not count.** It has {what};\n{asked}, none of them disturbed. "
        f"What follows shows what is measured, and proves nothing.\n{load}"
    )


def find_disturbances(run: ExperimentRun, samples: Sequence[MachineSample]) -> Iterator[str]:
    """The repetitions that the plan sets aside, each with its reason."""
    for repetition in sorted({trial.repetition for trial in run.trials}):
        if why := explain_disturbance(run, samples, repetition):
            yield f"repetition {repetition}: {why}"


def describe_machine(run: ExperimentRun, samples: Sequence[MachineSample]) -> str:
    """How much processes outside of the experiment computed: the plan sets aside repetitions with more than a tenth of a core."""
    repetitions = sorted({trial.repetition for trial in run.trials})
    found = {
        each: measure_repetition([trial for trial in run.trials if trial.repetition == each], samples)
        for each in repetitions
    }
    means = {repetition: cores for repetition, cores in found.items() if cores is not None}
    if not means:
        return "What else the machine did was not recorded."
    busy = [str(repetition) for repetition, cores in sorted(means.items()) if cores > BUSY_CORES]
    above = (
        f"above {BUSY_CORES:g} in repetition {', '.join(busy)}" if busy else f"in none above {BUSY_CORES:g}"
    )
    least, most = (f"{cores:.2f}" for cores in (min(means.values()), max(means.values())))
    cores = least if least == most else f"{least} to {most}"
    return f"Other processes of the machine used {cores} cores on average in a repetition, {above}."


def render_ages(run: ExperimentRun) -> str:
    """Age of data, misses, gaps and traffic by scheme: sums and means over its trials."""
    heading = (
        "scheme",
        "age of a result p50 / p95 / p99 ms",
        "deadline misses",
        "pictures/s",
        "handoffs",
        "gap at the robot s",
        "CPU s of all hosts",
        "MB on the air per robot",
    )
    rows = list[tuple[str, ...]]()
    for result in summarize_trials(run):
        trials = [trial for trial in run.trials if trial.scheme == result.scheme.name]
        rows.append((result.scheme.name, *_list_cells(result, trials)))
    return render_table(heading, rows)


def _list_cells(result: SchemeResult, trials: Sequence[Trial]) -> list[str]:
    ages = [result.metrics.get(f"latency/{name}_ms") for name in ("p50", "p95", "p99")]
    values, misses = _sum_last(trials, "latency/values"), _sum_last(trials, "latency/misses")
    gaps = [each.gap for trial in trials for each in trial.handoffs if each.gap is not None]
    return [
        " / ".join("-" if age is None else f"{age.mean:.0f}" for age in ages),
        f"{100 * misses / values:.0f} % of {values:.0f}" if values else "-",
        _format_mean(result, "fps", 2),
        _format_mean(result, "handoffs", 1),
        f"{compute_estimate(gaps).mean:.1f}" if gaps else "-",
        _format_mean(result, "cpu_s", 0),
        _format_mean(result, "air", 1),
    ]


def _sum_last(trials: Sequence[Trial], metric: str) -> float:
    return sum(
        readings[-1].value
        for trial in trials
        for readings in trial.readings.get(metric, {}).values()
        if readings
    )


def _format_mean(result: SchemeResult, metric: str, digits: int) -> str:
    found = result.metrics.get(metric) or next(iter(result.estimates.get(metric, ())), None)
    return "-" if found is None else f"{found.mean:.{digits}f}"


def render_periods(run: ExperimentRun) -> str:
    """Time between two plans by scheme: in cycles without a handoff, and in those with one."""
    lines = [
        "| scheme | quiet cycles | s, median | cycles with handoffs | s, median |\n",
        "|---|---:|---:|---:|---:|\n",
    ]
    for scheme in run.experiment.schemes:
        quiet: list[float] = []
        busy: list[float] = []
        for trial in (each for each in run.trials if each.scheme == scheme.name):
            times = next(iter(trial.loads.values()), ())
            for before, after in pairwise(times):
                moved = any(before.at <= each.at < after.at for each in trial.handoffs)
                started = any(before.at <= each.start < after.at for each in trial.spans)
                (busy if moved else quiet if not started else []).append(after.at - before.at)
        cells = [f"{len(found)} | {_find_median(found)}" for found in (quiet, busy)]
        lines.append(f"| {scheme.name} | {' | '.join(cells)} |\n")
    return "".join(lines)


def _find_median(values: Sequence[float]) -> str:
    return f"{sorted(values)[len(values) // 2]:.1f}" if values else "-"


def render_hypotheses(run: ExperimentRun) -> str:
    """What the run says of each hypothesis of the plan, in one sentence with its interval."""
    compared = compare_schemes(summarize_trials(run), run.experiment.equivalence)
    found = {
        each.base: each for each in compared if (each.metric, each.scheme) == (MISSION_TIME, "utility all")
    }
    lines = [
        f"| {name} | {describe_answer(found[base])} |\n" for name, base in HYPOTHESES.items() if base in found
    ]
    return "".join(("| | outcome |\n", "|---|---|\n", *lines))


MODEL_PARTS: Mapping[str, Callable[[ExperimentRun], str]] = {
    "recoveries": lambda run: render_recoveries(run, RUNS),
    "pictures": lambda run: render_pictures(run, RUNS),
    "edges": lambda run: render_edges(run, RUNS),
    "local": render_local,
    "changing links": lambda _run: render_changing_links(),
}
PARTS: Mapping[str, Callable[[ExperimentRun], str]] = {
    "hypotheses": render_hypotheses,
    "ages": render_ages,
    "periods": render_periods,
    "whereabouts": render_whereabouts,
    "starts": render_starts,
    "times": lambda run: render_times([("pilot trials", load_run(PILOT)), ("this run", run)]),
}


def take_over(source: Path, target: Path) -> None:
    """Replace the run in ``target`` by a complete one."""
    run = load_run(source)
    planned = run.experiment.repetitions * len(run.experiment.schemes)
    if len(run.trials) != planned:
        sys.exit(f"{source} has {len(run.trials)} of {planned} trials: make experiment goes on with it")
    shutil.rmtree(target, ignore_errors=True)
    beside = [path for path in (source / FILE_NAME,) if path.exists()]
    aside = (path for path in (source / ASIDE).glob("*/*") if path.is_file())
    for path in (source / "run.json", *(source / "trials").glob("*.json"), *beside, *aside):
        copy = target / path.relative_to(source)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
        copy.chmod(0o644)


def run_edgectl(words: Sequence[str], state: Path) -> str:
    """The output of one command, as on a terminal of 80 columns that is none."""
    command = [sys.executable, "-m", "edgectl", *words]
    return subprocess.run(
        command, cwd=ROOT, env=environment(state), capture_output=True, text=True, check=True
    ).stdout


def draw_figures(run: Path, figures: Path, directory: Path) -> None:
    """Draw the ``figures`` of the page from this run; ``directory``: for what is not kept."""
    words = ["report", str(run), "--out", str(directory / "report.html")]
    run_edgectl([*words, "--figures", str(directory / "figures")], directory / "state")
    for name in DRAWN:
        shutil.copyfile(directory / "figures" / name, figures / name)


def write_exact_blocks(text: str, state: Path) -> str:
    """The page with the present output of the commands whose output is compared."""

    def rewrite(block: re.Match[str]) -> str:
        commands = [line for line in block[2].splitlines() if line.startswith("$ edgectl ")]
        shown = [f"{line}\n{run_edgectl(line.split()[2:], state)}" for line in commands]
        return block[1] + "".join(shown) + block[3]

    return _EXACT.sub(rewrite, text)


def write_page(page: Path, run: Path, figures: Path) -> None:
    """Draw the figures of the run, then write the parts and the outputs of the page."""
    with tempfile.TemporaryDirectory(prefix="edgectl-evaluation-") as directory:
        draw_figures(run, figures, Path(directory))
        text = write_model_parts(write_model(write_parts(page.read_text(), run)), *MODEL_PARTS)
        page.write_text(write_exact_blocks(text, Path(directory) / "state"))


def main() -> None:
    """Take over the run, draw, and write the page."""
    parser = argparse.ArgumentParser(description="The tables and figures of docs/evaluation.md.")
    parser.add_argument("--run", type=Path, default=ROOT / "runs" / "patrol", help="a run to take over")
    args = parser.parse_args()
    if (args.run / "run.json").exists():
        take_over(args.run, RUN)
    write_page(PAGE, RUN.relative_to(ROOT), FIGURES)


if __name__ == "__main__":
    main()
