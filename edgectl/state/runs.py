"""Runs of experiments on disk: one directory each, ``run.json`` and a file per trial. It is enough by itself, wherever it is copied to."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from edgectl.errors import FileError
from edgectl.formats import run as form
from edgectl.formats.base import FormatErrors
from edgectl.model.experiment import Experiment, Run, Trial
from edgectl.state.files import Warn, read_json, set_aside, write_json

Value = TypeVar("Value")

NAME, TRIALS = "run.json", "trials"


def read_run(directory: Path) -> Run:
    """The run in ``directory`` with its trials, in the order of schemes, then repetitions.

    Raises:
        FileError: there is none, or a file of it is damaged.
        StateError: a newer edgectl wrote it.
    """
    run = _head(directory)
    return replace(run, trials=tuple(_trials(directory, run.experiment, _refuse)))


def resumed(directory: Path, warn: Warn) -> Run | None:
    """The same for an experiment that goes on: None where there is no run yet; a damaged trial is set aside, said, and made again.

    Raises:
        FileError: ``run.json`` is damaged, or the directory holds something else.
        StateError: a newer edgectl wrote it.
    """
    if not (directory / NAME).exists():
        if directory.exists() and not _barely_begun(directory):
            raise FileError(f"{directory} is not empty, and no run of an experiment", hint="give another directory: --out DIR")
        return None

    def aside(path: Path, why: str) -> None:
        warn(f"{path} is damaged ({why}); set aside as {set_aside(path).name}, the trial is made again")

    run = _head(directory)
    return replace(run, trials=tuple(_trials(directory, run.experiment, aside)))


def _barely_begun(directory: Path) -> bool:
    """Whether nothing stands there but what a `save_run` that was cut off leaves."""
    left = {path.relative_to(directory).as_posix() for path in (*directory.iterdir(), *directory.glob(f"{TRIALS}/*"))}
    return left <= {TRIALS, f"{NAME}.tmp"}


def newest_run(parent: Path) -> Path | None:
    """The directory in ``parent`` with the run that was begun or extended last; None where there is none."""
    runs = [(path.stat().st_mtime_ns, path.parent) for path in parent.glob(f"*/{NAME}") if path.is_file()]
    return max(runs)[1] if runs else None


def save_run(directory: Path, run: Run) -> None:
    """Write what all trials share, whole or not at all.

    Raises:
        FileError: the directory cannot be made.
        StateError: the disk does not take the file.
    """
    try:
        (directory / TRIALS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot make {directory}: {error.strerror}", hint="give another directory: --out DIR") from error
    write_json(directory / NAME, form.encode(replace(run, trials=())), keep=False)


def save_trial(directory: Path, trial: Trial) -> None:
    """Add a trial, whole or not at all.

    Raises:
        StateError: the disk does not take it.
    """
    write_json(_path(directory, trial.scheme, trial.repetition), form.encode_trial(trial), keep=False)


def in_order(experiment: Experiment) -> Iterator[tuple[str, int]]:
    """Scheme and repetition of every trial of the experiment, as a run lists them."""
    for variant in experiment.variants:
        yield from ((variant.name, repetition) for repetition in range(1, experiment.repetitions + 1))


def _path(directory: Path, scheme: str, repetition: int) -> Path:
    return directory / TRIALS / f"{scheme.replace(' ', '-')}-{repetition}.json"


def _head(directory: Path) -> Run:
    try:
        found = _read(directory / NAME, form.decode)
    except ValueError as error:
        raise FileError(
            f"{directory / NAME} is damaged: {error}", hint="put it back, or begin anew in another directory: --out DIR"
        ) from error
    if found is None:
        raise FileError(f"there is no run in {directory}: no {NAME}", hint="name a directory that edgectl experiment run wrote")
    return found


def _trials(directory: Path, experiment: Experiment, broken: Callable[[Path, str], None]) -> Iterator[Trial]:
    for scheme, repetition in in_order(experiment):
        path = _path(directory, scheme, repetition)
        try:
            trial = _read(path, form.decode_trial)
        except ValueError as error:
            broken(path, str(error))
            continue
        if trial is not None and (trial.scheme, trial.repetition) != (scheme, repetition):
            broken(path, f"it is of {trial.scheme}, repetition {trial.repetition}")
        elif trial is not None:
            yield trial


def _refuse(path: Path, why: str) -> None:
    raise FileError(f"{path} is damaged: {why}", hint="run the experiment again: it makes this trial anew")


def _read(path: Path, decode: Callable[[object], Value]) -> Value | None:
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
