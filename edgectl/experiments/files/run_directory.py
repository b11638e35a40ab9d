"""Runs of experiments on disk: one directory each, ``run.json`` and a file per trial. It is enough by itself, wherever it is copied to."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from edgectl.errors import FileError
from edgectl.experiments.files import run_codec as form
from edgectl.experiments.model.experiment import Experiment, ExperimentRun, Trial
from edgectl.formats.document import FormatErrors
from edgectl.state.json_files import Warn, read_json, set_aside, write_json

Value = TypeVar("Value")

RUN_FILE_NAME, TRIALS_DIR_NAME = "run.json", "trials"


def load_run(directory: Path) -> ExperimentRun:
    """The run in ``directory`` with its trials, in the order of schemes, then repetitions.

    Raises:
        FileError: there is none, or a file of it is damaged.
        StateError: a newer edgectl wrote it.
    """
    run = _load_run_header(directory)
    return replace(run, trials=tuple(_load_trials(directory, run.experiment, _raise_damaged_trial)))


def load_run_to_resume(directory: Path, warn: Warn) -> ExperimentRun | None:
    """The same for an experiment that goes on: None where there is no run yet; a damaged trial is set aside, said, and made again.

    Raises:
        FileError: ``run.json`` is damaged, or the directory holds something else.
        StateError: a newer edgectl wrote it.
    """
    if not (directory / RUN_FILE_NAME).exists():
        if directory.exists() and not _is_aborted_start(directory):
            raise FileError(
                f"{directory} is not empty, and no run of an experiment",
                hint="give another directory: --out DIR",
            )
        return None

    def aside(path: Path, why: str) -> None:
        warn(f"{path} is damaged ({why}); set aside as {set_aside(path).name}, the trial is made again")

    run = _load_run_header(directory)
    return replace(run, trials=tuple(_load_trials(directory, run.experiment, aside)))


def _is_aborted_start(directory: Path) -> bool:
    """Whether nothing stands there but what a `save_run` that was cut off leaves."""
    left = {
        path.relative_to(directory).as_posix()
        for path in (*directory.iterdir(), *directory.glob(f"{TRIALS_DIR_NAME}/*"))
    }
    return left <= {TRIALS_DIR_NAME, f"{RUN_FILE_NAME}.tmp"}


def find_newest_run(parent: Path) -> Path | None:
    """The directory in ``parent`` with the run that was begun or extended last; None where there is none."""
    runs = [
        (path.stat().st_mtime_ns, path.parent) for path in parent.glob(f"*/{RUN_FILE_NAME}") if path.is_file()
    ]
    return max(runs)[1] if runs else None


def save_run(directory: Path, run: ExperimentRun) -> None:
    """Write what all trials share, whole or not at all.

    Raises:
        FileError: the directory cannot be made.
        StateError: the disk does not take the file.
    """
    try:
        (directory / TRIALS_DIR_NAME).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"cannot make {directory}: {error.strerror}", hint="give another directory: --out DIR"
        ) from error
    write_json(directory / RUN_FILE_NAME, form.encode_run(replace(run, trials=())), keep=False)


def save_trial(directory: Path, trial: Trial) -> None:
    """Add a trial, whole or not at all.

    Raises:
        StateError: the disk does not take it.
    """
    write_json(
        _build_trial_path(directory, trial.scheme, trial.repetition), form.encode_trial(trial), keep=False
    )


def list_planned_trials(experiment: Experiment) -> Iterator[tuple[str, int]]:
    """Scheme and repetition of every trial of the experiment, as a run lists them."""
    for variant in experiment.schemes:
        yield from ((variant.name, repetition) for repetition in range(1, experiment.repetitions + 1))


def _build_trial_path(directory: Path, scheme: str, repetition: int) -> Path:
    return directory / TRIALS_DIR_NAME / f"{scheme.replace(' ', '-')}-{repetition}.json"


def _load_run_header(directory: Path) -> ExperimentRun:
    try:
        found = _load_run_document(directory / RUN_FILE_NAME, form.decode_run)
    except ValueError as error:
        raise FileError(
            f"{directory / RUN_FILE_NAME} is damaged: {error}",
            hint="put it back, or begin anew in another directory: --out DIR",
        ) from error
    if found is None:
        raise FileError(
            f"there is no run in {directory}: no {RUN_FILE_NAME}",
            hint="name a directory that edgectl experiment run wrote",
        )
    return found


def _load_trials(
    directory: Path, experiment: Experiment, broken: Callable[[Path, str], None]
) -> Iterator[Trial]:
    for scheme, repetition in list_planned_trials(experiment):
        path = _build_trial_path(directory, scheme, repetition)
        try:
            trial = _load_run_document(path, form.decode_trial)
        except ValueError as error:
            broken(path, str(error))
            continue
        if trial is not None and (trial.scheme, trial.repetition) != (scheme, repetition):
            broken(path, f"it is of {trial.scheme}, repetition {trial.repetition}")
        elif trial is not None:
            yield trial


def _raise_damaged_trial(path: Path, why: str) -> None:
    raise FileError(f"{path} is damaged: {why}", hint="run the experiment again: it makes this trial anew")


def _load_run_document(path: Path, decode: Callable[[object], Value]) -> Value | None:
    """The value in ``path``, None where there is no file.

    Raises:
        ValueError: it is damaged; the message says how.
        StateError: a newer edgectl wrote it.
    """
    try:
        document = read_json(path)
        return None if document is None else decode(document)
    except FormatErrors as error:
        raise ValueError(error.message) from error
