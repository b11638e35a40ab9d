# SPDX-License-Identifier: Apache-2.0
"""Directory of an experiment run: ``run.json`` and a file per trial.

It is self-contained and can be copied.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from edgectl.errors import FileError, UsageError
from edgectl.experiments.files.run_codec import RUN_KIND, TRIAL_KIND
from edgectl.experiments.model.experiment import Experiment, ExperimentRun, Trial
from edgectl.formats.document import FormatErrors
from edgectl.state.json_files import Warn, read_json, set_aside, write_json

Value = TypeVar("Value")

RUN_FILE_NAME, TRIALS_DIR_NAME, LOCK_FILE_NAME = "run.json", "trials", "lock"


def load_run(directory: Path) -> ExperimentRun:
    """The run in ``directory`` with its trials, ordered by scheme, then repetition.

    Raises:
        UsageError: there is no run.
        FileError: one of its files is damaged.
        StateError: a newer edgectl wrote it.
    """
    run = _load_run_header(directory)
    return replace(run, trials=tuple(_load_trials(directory, run.experiment, _raise_damaged_trial)))


def load_run_to_resume(directory: Path, warn: Warn) -> ExperimentRun | None:
    """The run to resume; None if there is none yet.

    A damaged trial file is set aside with a warning, to be run again.

    Raises:
        FileError: ``run.json`` is damaged, or the directory holds something else.
        StateError: a newer edgectl wrote it.
    """
    if not (directory / RUN_FILE_NAME).exists():
        if directory.exists() and not _is_aborted_start(directory):
            raise FileError(
                f"{directory} is not empty and holds no experiment run",
                hint="choose another directory: --out DIR",
            )
        return None

    def set_damaged_aside(path: Path, why: str) -> None:
        warn(f"{path} is damaged ({why}); moved to {set_aside(path).name}, the trial is run again")

    run = _load_run_header(directory)
    return replace(run, trials=tuple(_load_trials(directory, run.experiment, set_damaged_aside)))


def _is_aborted_start(directory: Path) -> bool:
    """Whether the directory holds only what an experiment leaves that ended before `save_run`."""
    left = {
        path.relative_to(directory).as_posix()
        for path in (*directory.iterdir(), *directory.glob(f"{TRIALS_DIR_NAME}/*"))
    }
    return left <= {TRIALS_DIR_NAME, LOCK_FILE_NAME, f"{RUN_FILE_NAME}.tmp"}


def find_newest_run(parent: Path) -> Path | None:
    """The directory in ``parent`` with the run that was started or resumed last; None if there is none."""
    runs = [
        (path.stat().st_mtime_ns, path.parent) for path in parent.glob(f"*/{RUN_FILE_NAME}") if path.is_file()
    ]
    return max(runs)[1] if runs else None


def create_run_directory(directory: Path) -> None:
    """Create the directory of a run and that of its trials.

    Raises:
        FileError: one of them cannot be created.
    """
    try:
        (directory / TRIALS_DIR_NAME).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"cannot create {directory}: {error.strerror}", hint="choose another directory: --out DIR"
        ) from error


def save_run(directory: Path, run: ExperimentRun) -> None:
    """Write ``run.json``, atomically; trials are files of their own.

    Raises:
        FileError: the directory cannot be created.
        StateError: the file cannot be written.
    """
    create_run_directory(directory)
    write_json(directory / RUN_FILE_NAME, RUN_KIND.encode(replace(run, trials=())), keep=False)


def save_trial(directory: Path, trial: Trial) -> None:
    """Write the file of a trial, atomically.

    Raises:
        StateError: the file cannot be written.
    """
    write_json(
        _build_trial_path(directory, trial.scheme, trial.repetition), TRIAL_KIND.encode(trial), keep=False
    )


def list_planned_trials(experiment: Experiment) -> Iterator[tuple[str, int]]:
    """(scheme, repetition) of every trial of the experiment, in the order of a run."""
    for scheme in experiment.schemes:
        yield from ((scheme.name, repetition) for repetition in range(1, experiment.repetitions + 1))


def _build_trial_path(directory: Path, scheme: str, repetition: int) -> Path:
    return directory / TRIALS_DIR_NAME / f"{scheme.replace(' ', '-')}-{repetition}.json"


def _load_run_header(directory: Path) -> ExperimentRun:
    try:
        found = _load_run_document(directory / RUN_FILE_NAME, RUN_KIND.decode)
    except ValueError as error:
        raise FileError(
            f"{directory / RUN_FILE_NAME} is damaged: {error}",
            hint="restore it, or start again in another directory: --out DIR",
        ) from error
    if found is None:
        raise UsageError(
            f"no run in {directory}: {RUN_FILE_NAME} not found",
            hint="name a directory written by edgectl experiment run",
        )
    return found


def _load_trials(
    directory: Path, experiment: Experiment, report_damaged: Callable[[Path, str], None]
) -> Iterator[Trial]:
    for scheme, repetition in list_planned_trials(experiment):
        path = _build_trial_path(directory, scheme, repetition)
        try:
            trial = _load_run_document(path, TRIAL_KIND.decode)
        except ValueError as error:
            report_damaged(path, str(error))
            continue
        if trial is not None and (trial.scheme, trial.repetition) != (scheme, repetition):
            report_damaged(path, f"it holds {trial.scheme}, repetition {trial.repetition}")
        elif trial is not None:
            yield trial


def _raise_damaged_trial(path: Path, why: str) -> None:
    raise FileError(f"{path} is damaged: {why}", hint="run the experiment again: it repeats this trial")


def _load_run_document(path: Path, decode: Callable[[object], Value]) -> Value | None:
    """The value in ``path``, None if there is no file.

    Raises:
        ValueError: the file is damaged; the message says how.
        StateError: a newer edgectl wrote it.
    """
    try:
        document = read_json(path)
        return None if document is None else decode(document)
    except FormatErrors as error:
        raise ValueError(error.message) from error
