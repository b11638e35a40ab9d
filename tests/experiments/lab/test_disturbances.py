# SPDX-License-Identifier: Apache-2.0
"""Repetitions that do not count are found in the records of real trials, set aside with their reason, and run again."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.experiments.files.run_directory import load_run, load_run_to_resume, save_trial
from edgectl.experiments.model.experiment import ExperimentRun
from tests.experiments.lab.disturbances import explain_disturbance, list_set_aside, set_disturbed_aside
from tests.experiments.lab.machine import EVERY_S, FILE_NAME, MachineSample

# A run before the counted one: three repetitions of two schemes; in the third trial of static the stranger did not run.
CHECK = Path(__file__).parent / "pilot"


def watch(run: ExperimentRun, *, busy_in: int = 0, silent_in: int = 0) -> list[MachineSample]:
    """Samples as a machine would leave them that did little else, but for these repetitions."""
    found = []
    for trial in run.trials:
        for number in range(int(trial.latency / EVERY_S) + 2):
            if trial.repetition == silent_in and trial.scheme == "static" and 4 <= number < 12:
                continue
            own = 1.45 - 0.4 * (trial.repetition == busy_in and trial.scheme == "utility all")
            found.append(MachineSample(at=trial.began_at + EVERY_S * number, busy=1.5, own=own))
    return sorted(found, key=lambda each: each.at)


def test_a_repetition_counts_that_nothing_disturbed() -> None:
    run = load_run(CHECK)
    assert [explain_disturbance(run, watch(run), number) for number in (2, 1)] == ["", ""]


def test_a_stranger_that_did_not_run_is_named() -> None:
    run = load_run(CHECK)
    assert explain_disturbance(run, watch(run), 3) == "static: event stranger: edge1 used 0.03 of 0.45 cores"


def test_an_event_that_failed_is_named() -> None:
    run = load_run(CHECK)
    trials = tuple(
        replace(each, events=tuple(replace(event, error="no tc") for event in each.events[:1]))
        for each in run.trials
    )
    said = explain_disturbance(replace(run, trials=trials), watch(run), 1)
    assert said == "static: event links: no tc; utility all: event links: no tc"


@pytest.mark.parametrize("number", [2, 1])
def test_other_processes_and_a_machine_that_slept_are_named(number: int) -> None:
    """Above a tenth of a core over the repetition, though one scheme alone was disturbed."""
    run = load_run(CHECK)
    said = explain_disturbance(run, watch(run, busy_in=number), number)
    assert said == "other processes used 0.25 cores"
    assert explain_disturbance(run, watch(run, busy_in=number), 3 - number) == ""
    assert (
        explain_disturbance(run, watch(run, silent_in=number), number)
        == "static: the machine was not watched for 45 s"
    )
    assert "was not watched" in explain_disturbance(run, [], number)


def test_what_does_not_count_is_set_aside_and_missing_for_the_next_run(tmp_path: Path) -> None:
    directory = tmp_path / "patrol"
    shutil.copytree(CHECK, directory)
    run = load_run(directory)
    write_samples(directory, watch(run, busy_in=1))
    assert set_disturbed_aside(directory) == [
        "repetition 1: other processes used 0.25 cores",
        "repetition 3: static: event stranger: edge1 used 0.03 of 0.45 cores",
    ]
    resumed = load_run_to_resume(directory, pytest.fail)
    assert resumed is not None
    assert {trial.repetition for trial in resumed.trials} == {2}
    assert set_disturbed_aside(directory) == [], "what is missing is not judged"
    for trial in run.trials:
        if trial.repetition == 1:
            save_trial(directory, trial)
    assert len(set_disturbed_aside(directory)) == 1, "disturbed once more"
    write_samples(directory, watch(run))
    for trial in run.trials:
        if trial.repetition == 1:
            save_trial(directory, trial)
    assert set_disturbed_aside(directory) == []
    assert [said.split(":")[0] for said in list_set_aside(directory)] == [
        "repetition 1",
        "repetition 1",
        "repetition 3",
    ]
    kept = sorted(
        path.relative_to(directory / "set-aside").as_posix() for path in directory.glob("set-aside/*/*.json")
    )
    assert kept == [
        f"{place}/{scheme}-{place[0]}.json"
        for place in ("1-1", "1-2", "3-1")
        for scheme in ("static", "utility-all")
    ]


def write_samples(directory: Path, samples: list[MachineSample]) -> None:
    lines = [json.dumps({"at": each.at, "busy": each.busy, "own": each.own}) for each in samples]
    (directory / FILE_NAME).write_text("\n".join(lines) + "\n")
