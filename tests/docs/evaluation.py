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
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.model.comparison import SchemeResult
from edgectl.experiments.model.experiment import ExperimentRun, Trial
from edgectl.experiments.scheme_results import compute_estimate, summarize_trials
from tests.docs.blocks import environment
from tests.experiments.lab.machine import FILE_NAME, MachineSample, compute_others, load_samples

ROOT = Path(__file__).parents[2]
PAGE, RUN, FIGURES = ROOT / "docs" / "evaluation.md", ROOT / "docs" / "experiment", ROOT / "docs" / "figures"
DRAWN = ("latency.svg", "cpu.svg", "gantt.svg", "metric-1.svg")
# The plan of the evaluation counts a run from so many repetitions on.
COUNTED = 10
# It sets a repetition aside in which others used more.
BUSY_CORES = 0.1
_PART = re.compile(r"(<!-- from the run: (\w+) -->\n).*?(<!-- end -->\n)", re.DOTALL)
_EXACT = re.compile(r"(<!-- exact -->\n```console\n)(.*?)(^```$)", re.MULTILINE | re.DOTALL)


def write_parts(text: str, run: ExperimentRun) -> str:
    """The page with the parts that state figures of the run."""
    return _PART.sub(lambda part: part[1] + PARTS[part[2]](run) + part[3], text)


def describe_status(run: ExperimentRun) -> str:
    """How many trials there are, of when, and whether they count as evidence."""
    complete = min(sum(trial.scheme == each.name for trial in run.trials) for each in run.experiment.schemes)
    first = datetime.fromtimestamp(min(trial.began_at for trial in run.trials), UTC).date().isoformat()
    what = f"{len(run.trials)} trials of {first}, {complete} of each scheme"
    load = describe_machine(run, load_samples(RUN / FILE_NAME))
    if complete >= COUNTED:
        return f"The run: {what}.\n{load}\n"
    return (
        f"**This run does not count.** It has {what};\nthe [plan](evaluation/plan.md) asks for {COUNTED}. "
        f"What follows shows what is measured, and proves nothing.\n{load}\n"
    )


def describe_machine(run: ExperimentRun, samples: Sequence[MachineSample]) -> str:
    """How much processes outside of the experiment computed: the plan sets aside repetitions with more than a tenth of a core."""
    found: dict[int, list[float]] = {}
    for trial in run.trials:
        others = compute_others(samples, trial.began_at, trial.began_at + trial.latency)
        if others is not None:
            found.setdefault(trial.repetition, []).append(others)
    if not found:
        return "What else the machine did was not recorded."
    means = {repetition: sum(cores) / len(cores) for repetition, cores in found.items()}
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
    lines = [heading, ("---", *["---:"] * (len(heading) - 1))]
    for result in summarize_trials(run):
        trials = [trial for trial in run.trials if trial.scheme == result.scheme.name]
        lines.append((result.scheme.name, *_list_cells(result, trials)))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


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


PARTS: Mapping[str, Callable[[ExperimentRun], str]] = {
    "status": describe_status,
    "ages": render_ages,
    "periods": render_periods,
}


def take_over(source: Path) -> None:
    """Replace the committed run by a complete one."""
    run = load_run(source)
    planned = run.experiment.repetitions * len(run.experiment.schemes)
    if len(run.trials) != planned:
        sys.exit(f"{source} has {len(run.trials)} of {planned} trials: make experiment goes on with it")
    shutil.rmtree(RUN, ignore_errors=True)
    (RUN / "trials").mkdir(parents=True)
    beside = [path for path in (source / FILE_NAME,) if path.exists()]
    for path in (source / "run.json", *(source / "trials").glob("*.json"), *beside):
        target = RUN / path.relative_to(source)
        shutil.copyfile(path, target)
        target.chmod(0o644)


def run_edgectl(words: Sequence[str], state: Path) -> str:
    """The output of one command, as on a terminal of 80 columns that is none."""
    command = [sys.executable, "-m", "edgectl", *words]
    return subprocess.run(
        command, cwd=ROOT, env=environment(state), capture_output=True, text=True, check=True
    ).stdout


def draw_figures(directory: Path) -> None:
    """Draw the figures of the page from the committed run."""
    words = ["report", "docs/experiment", "--out", str(directory / "report.html")]
    run_edgectl([*words, "--figures", str(directory / "figures")], directory / "state")
    for name in DRAWN:
        shutil.copyfile(directory / "figures" / name, FIGURES / name)


def write_exact_blocks(text: str, state: Path) -> str:
    """The page with the present output of the commands whose output is compared."""

    def rewrite(block: re.Match[str]) -> str:
        commands = [line for line in block[2].splitlines() if line.startswith("$ edgectl ")]
        shown = [f"{line}\n{run_edgectl(line.split()[2:], state)}" for line in commands]
        return block[1] + "".join(shown) + block[3]

    return _EXACT.sub(rewrite, text)


def main() -> None:
    """Take over the run, draw, and write the page."""
    parser = argparse.ArgumentParser(description="The tables and figures of docs/evaluation.md.")
    parser.add_argument("--run", type=Path, default=ROOT / "runs" / "patrol", help="a run to take over")
    args = parser.parse_args()
    if (args.run / "run.json").exists():
        take_over(args.run)
    with tempfile.TemporaryDirectory(prefix="edgectl-evaluation-") as directory:
        draw_figures(Path(directory))
        text = write_parts(PAGE.read_text(), load_run(RUN))
        PAGE.write_text(write_exact_blocks(text, Path(directory) / "state"))


if __name__ == "__main__":
    main()
