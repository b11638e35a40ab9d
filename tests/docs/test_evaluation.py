# SPDX-License-Identifier: Apache-2.0
"""The evaluation page states the figures of the committed run."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.experiments.files.run_directory import load_run, save_run, save_trial
from edgectl.experiments.model.experiment import ExperimentRun
from tests.docs import evaluation
from tests.experiments.lab.machine import FILE_NAME, MachineSample

CHECK = evaluation.ROOT / "tests" / "experiments" / "lab" / "pilot"


def test_the_page_is_that_of_its_run() -> None:
    text = evaluation.PAGE.read_text()
    assert evaluation.write_parts(text, evaluation.RUN) == text, "make evaluation"
    assert all(f"from the run: {name} -->" in text for name in ("status", *evaluation.PARTS))
    assert all(f"(figures/{name})" in text for name in evaluation.DRAWN)


def test_other_figures_would_be_seen() -> None:
    run = load_run(evaluation.RUN)
    late = tuple(replace(trial, handoffs=trial.handoffs * 3) for trial in run.trials)
    assert any(trial.handoffs for trial in run.trials)
    assert evaluation.render_ages(replace(run, trials=late)) != evaluation.render_ages(run)


def build_counted_run(repetitions: int) -> tuple[ExperimentRun, list[MachineSample]]:
    """A run in which nothing was disturbed, of trials that are kept; every third repetition takes longer."""
    run = load_run(CHECK)
    first = {trial.scheme: trial for trial in run.trials if trial.repetition == 1}
    trials = tuple(
        replace(
            first[scheme.name],
            repetition=number,
            began_at=1000.0 * number + 500.0 * position,
            latency=first[scheme.name].latency + 5.0 * (number % 3),
        )
        for position, scheme in enumerate(run.experiment.schemes)
        for number in range(1, repetitions + 1)
    )
    samples = [MachineSample(at=at, busy=1.0, own=0.95) for at in range(1000, 1000 * (repetitions + 1), 5)]
    return replace(run, trials=trials, experiment=replace(run.experiment, repetitions=repetitions)), samples


@pytest.mark.parametrize(("repetitions", "counts"), [(9, False), (10, True)])
def test_a_run_counts_from_ten_repetitions_on(repetitions: int, counts: bool) -> None:
    run, samples = build_counted_run(repetitions)
    assert ("does not count" not in evaluation.write_status(run, samples, [])) == counts


def test_a_disturbed_repetition_does_not_count() -> None:
    run, samples = build_counted_run(10)
    busy = [replace(each, busy=1.3) if 3000 < each.at < 4000 else each for each in samples]
    said = evaluation.write_status(run, busy, ["repetition 7: why"])
    assert "does not count" in said
    assert "To be repeated: repetition 3: other processes used 0.35 cores.\n" in said
    assert "Set aside and run again: repetition 7: why.\n" in said


def test_a_run_becomes_a_page_without_a_hand(tmp_path: Path) -> None:
    """Taken over, drawn, and stated: what `make evaluation` does once the counted run is complete."""
    run, samples = build_counted_run(10)
    source, target, figures = (tmp_path / name for name in ("source", "taken", "figures"))
    figures.mkdir()
    page = tmp_path / "page.md"
    page.write_text(
        "".join(f"<!-- from the run: {name} -->\n<!-- end -->\n" for name in ("status", *evaluation.PARTS))
        + f"<!-- exact -->\n```console\n$ edgectl experiment show {target}\n```\n"
    )
    save_run(source, run)
    for trial in run.trials[1:]:
        save_trial(source, trial)
    with pytest.raises(SystemExit, match="has 19 of 20 trials: make experiment goes on with it"):
        evaluation.take_over(source, target)
    save_trial(source, run.trials[0])
    lines = [json.dumps({"at": each.at, "busy": each.busy, "own": each.own}) for each in samples]
    (source / FILE_NAME).write_text("\n".join(lines) + "\n")
    evaluation.take_over(source, target)
    evaluation.write_page(page, target, figures)
    text = page.read_text()
    assert text.startswith(
        "<!-- from the run: status -->\nThe run: 20 trials of 1970-01-01, 10 of each scheme.\n"
    )
    assert (
        "Other processes of the machine used 0.05 cores on average in a repetition, in none above 0.1."
        in text
    )
    assert "| H1, primary | utility all finished the mission 13 % sooner than static (95 % interval" in text
    assert "20 of 20 trials of patrol" in text
    assert {path.name for path in figures.iterdir()} == set(evaluation.DRAWN)
    again = evaluation.write_parts(text, target)
    assert again == text
