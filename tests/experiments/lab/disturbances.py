# SPDX-License-Identifier: Apache-2.0
"""Repetitions in which the machine was not available or an event had no effect: found, set aside, named (docs/evaluation/plan.md)."""

import shutil
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from edgectl.experiments.files.run_directory import TRIALS_DIR_NAME, load_run
from edgectl.experiments.model.experiment import ExperimentRun, Trial
from tests.experiments.lab.machine import EVERY_S, FILE_NAME, MachineSample, compute_others, load_samples

# The plan of the evaluation counts a run from so many repetitions on.
COUNTED = 10
# It sets a repetition aside in which others used more.
BUSY_CORES = 0.1
# The machine was suspended, or nobody watched it.
_MOST_SILENT_S = 4 * EVERY_S
# The stranger takes all of its host for so long, of which this is the least share that is seen then.
LOAD_S, _LEAST_SHARE = 25.0, 0.8
ASIDE, _WHY = "set-aside", "why.txt"


def explain_disturbance(run: ExperimentRun, samples: Sequence[MachineSample], repetition: int) -> str:
    """Why this repetition has to be repeated; "" where it counts."""
    trials = [trial for trial in run.trials if trial.repetition == repetition]
    return "; ".join((*_explain_machine(trials, samples), *_explain_events(run, trials)))


def measure_repetition(trials: Sequence[Trial], samples: Sequence[MachineSample]) -> float | None:
    """Cores that others used on average, over these trials; None where that was not recorded."""
    found = [compute_others(samples, trial.began_at, trial.began_at + trial.latency) for trial in trials]
    known = [cores for cores in found if cores is not None]
    return sum(known) / len(known) if known else None


def _explain_machine(trials: Sequence[Trial], samples: Sequence[MachineSample]) -> Iterator[str]:
    others = measure_repetition(trials, samples)
    if others is not None and others > BUSY_CORES:
        yield f"other processes used {others:.2f} cores"
    for trial in trials:
        silent = _find_silence(samples, trial.began_at, trial.began_at + trial.latency)
        if silent > _MOST_SILENT_S:
            yield f"{trial.scheme}: the machine was not watched for {silent:.0f} s"


def _find_silence(samples: Sequence[MachineSample], since: float, until: float) -> float:
    """Longest time without a sample from ``since`` to ``until``."""
    moments = [since, *sorted(each.at for each in samples if since < each.at < until), until]
    return max(after - before for before, after in pairwise(moments))


def _explain_events(run: ExperimentRun, trials: Sequence[Trial]) -> Iterator[str]:
    for trial in trials:
        for record in trial.events:
            if record.error:
                yield f"{trial.scheme}: event {record.event}: {record.error}"
            elif record.kind == "load" and record.subject in run.machines:
                cores = run.machines[record.subject].cores
                used = measure_load(trial, record.subject, record.at)
                if used is not None and used < _LEAST_SHARE * cores:
                    yield f"{trial.scheme}: event {record.event}: {record.subject} used {used:.2f} of {cores:g} cores"


def measure_load(trial: Trial, host: str, began: float) -> float | None:
    """Cores that a host used on average under a load that began then; None without a sample."""
    until = min(began + LOAD_S, trial.latency)
    # A sample is of the half second before it, which should lie within the load.
    found = [each.cores for each in trial.loads.get(host, ()) if began + 1.5 < each.at <= until]
    return sum(found) / len(found) if found else None


def set_disturbed_aside(directory: Path) -> list[str]:
    """Move the trials of each complete repetition that does not count, so that it is run again; what was moved, and why."""
    run, samples = load_run(directory), load_samples(directory / FILE_NAME)
    names = {scheme.name for scheme in run.experiment.schemes}
    told = []
    for repetition in range(1, run.experiment.repetitions + 1):
        complete = {trial.scheme for trial in run.trials if trial.repetition == repetition} == names
        if complete and (why := explain_disturbance(run, samples, repetition)):
            told.append(f"repetition {repetition}: {why}")
            _move_trials(directory, repetition, why)
    return told


def _move_trials(directory: Path, repetition: int, why: str) -> None:
    number = 1
    while (target := directory / ASIDE / f"{repetition}-{number}").exists():
        number += 1
    target.mkdir(parents=True)
    (target / _WHY).write_text(f"{why}\n")
    for path in sorted((directory / TRIALS_DIR_NAME).glob(f"*-{repetition}.json")):
        shutil.move(path, target / path.name)


def list_set_aside(directory: Path) -> list[str]:
    """What was set aside in a run, and why."""
    found = sorted((directory / ASIDE).glob(f"*/{_WHY}"), key=lambda path: _read_numbers(path.parent.name))
    return [f"repetition {path.parent.name.split('-')[0]}: {path.read_text().strip()}" for path in found]


def _read_numbers(name: str) -> tuple[int, ...]:
    return tuple(map(int, name.split("-")))
