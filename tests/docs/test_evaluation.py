# SPDX-License-Identifier: Apache-2.0
"""The evaluation page states the figures of the committed run."""

from dataclasses import replace

import pytest

from edgectl.experiments.files.run_directory import load_run
from tests.docs import evaluation


def test_the_page_is_that_of_its_run() -> None:
    text = evaluation.PAGE.read_text()
    assert evaluation.write_parts(text, load_run(evaluation.RUN)) == text, "make evaluation"
    assert all(f"from the run: {name} -->" in text for name in evaluation.PARTS)
    assert all(f"(figures/{name})" in text for name in evaluation.DRAWN)


def test_other_figures_would_be_seen() -> None:
    run = load_run(evaluation.RUN)
    late = tuple(replace(trial, handoffs=trial.handoffs * 3) for trial in run.trials)
    text = evaluation.PAGE.read_text()
    assert any(trial.handoffs for trial in run.trials)
    assert evaluation.write_parts(text, replace(run, trials=late)) != text


@pytest.mark.parametrize(("repetitions", "counts"), [(9, False), (10, True)])
def test_a_run_counts_from_ten_repetitions_on(repetitions: int, counts: bool) -> None:
    run = load_run(evaluation.RUN)
    (first, *_) = run.trials
    trials = tuple(
        replace(first, scheme=scheme.name, repetition=number)
        for scheme in run.experiment.schemes
        for number in range(1, repetitions + 1)
    )
    assert ("does not count" not in evaluation.describe_status(replace(run, trials=trials))) == counts
