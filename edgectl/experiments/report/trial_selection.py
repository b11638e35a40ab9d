"""Selection of a run's trials, and the list of missing ones."""

from collections.abc import Sequence
from statistics import fmean

from edgectl.experiments.model.experiment import ExperimentRun, Trial
from edgectl.experiments.views.scheme_table import SHORT_MISSION_S


def list_tried_schemes(run: ExperimentRun) -> list[str]:
    """The schemes with at least one trial, in the order of the experiment."""
    done = {trial.scheme for trial in run.trials}
    return [scheme.name for scheme in run.experiment.schemes if scheme.name in done]


def is_mission_short(run: ExperimentRun) -> bool:
    """Whether the mean time of the mission is below two minutes under every scheme, so that it is in s."""
    means = [
        fmean(trial.latency for trial in select_trials(run, scheme)) for scheme in list_tried_schemes(run)
    ]
    return max(means, default=0.0) < SHORT_MISSION_S


def select_trials(run: ExperimentRun, scheme: str) -> list[Trial]:
    """The trials of a scheme, ordered by repetition."""
    return sorted(
        (trial for trial in run.trials if trial.scheme == scheme), key=lambda trial: trial.repetition
    )


def get_median_trial(run: ExperimentRun, scheme: str) -> Trial:
    """The trial of median latency (the faster of two), finished if there is any; the scheme needs a trial."""
    trials = sorted(
        select_trials(run, scheme), key=lambda trial: (not trial.finished, trial.latency, trial.repetition)
    )
    candidates = [trial for trial in trials if trial.finished] or trials
    return candidates[(len(candidates) - 1) // 2]


def list_missing_trials(run: ExperimentRun) -> Sequence[tuple[str, int]]:
    """(scheme, repetition) of each trial that has not run yet."""
    done = {(trial.scheme, trial.repetition) for trial in run.trials}
    planned = (
        (scheme.name, number)
        for scheme in run.experiment.schemes
        for number in range(1, run.experiment.repetitions + 1)
    )
    return [pair for pair in planned if pair not in done]
