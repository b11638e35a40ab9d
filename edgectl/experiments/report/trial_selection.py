"""Which trials a run has, and which it lacks."""

from collections.abc import Sequence

from edgectl.experiments.model.experiment import ExperimentRun, Trial


def list_tried_schemes(run: ExperimentRun) -> list[str]:
    """The schemes that have a trial, in the order of the experiment."""
    done = {trial.scheme for trial in run.trials}
    return [variant.name for variant in run.experiment.schemes if variant.name in done]


def select_trials(run: ExperimentRun, scheme: str) -> list[Trial]:
    """The trials of a scheme, by repetition."""
    return sorted(
        (trial for trial in run.trials if trial.scheme == scheme), key=lambda trial: trial.repetition
    )


def get_median_trial(run: ExperimentRun, scheme: str) -> Trial:
    """The trial of the median latency (of two the quicker), a finished one where there is any; the scheme has a trial."""
    trials = sorted(
        select_trials(run, scheme), key=lambda trial: (not trial.finished, trial.latency, trial.repetition)
    )
    among = [trial for trial in trials if trial.finished] or trials
    return among[(len(among) - 1) // 2]


def list_missing_trials(run: ExperimentRun) -> Sequence[tuple[str, int]]:
    """(scheme, repetition) of each trial that has not been run."""
    done = {(trial.scheme, trial.repetition) for trial in run.trials}
    every = (
        (variant.name, number)
        for variant in run.experiment.schemes
        for number in range(1, run.experiment.repetitions + 1)
    )
    return [pair for pair in every if pair not in done]
