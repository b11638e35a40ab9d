# SPDX-License-Identifier: Apache-2.0
"""Run directories: self-contained, never half written, with clear errors about damage."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.errors import FileError, StateError, UsageError
from edgectl.experiments.files.run_directory import (
    find_newest_run,
    load_run,
    load_run_to_resume,
    save_run,
    save_trial,
)
from edgectl.experiments.model.experiment import Trial
from tests.experiments.test_run_codec import RUN, TRIAL


def a_run(directory: Path, *trials: Trial) -> Path:
    save_run(directory, RUN)
    for trial in trials:
        save_trial(directory, trial)
    return directory


def test_a_copy_of_the_directory_is_the_whole_run(tmp_path: Path) -> None:
    first = replace(TRIAL, repetition=1)
    made = a_run(tmp_path / "runs" / "mission", TRIAL, first)
    assert sorted(path.name for path in (made / "trials").iterdir()) == [
        "utility-all-1.json",
        "utility-all-2.json",
    ]
    copy = tmp_path / "elsewhere"
    shutil.copytree(made, copy)
    shutil.rmtree(made)
    assert load_run(copy) == replace(RUN, trials=(first, TRIAL))


def test_trials_that_the_experiment_no_longer_has_are_left_out(tmp_path: Path) -> None:
    directory = a_run(
        tmp_path / "run", TRIAL, replace(TRIAL, repetition=1), replace(TRIAL, scheme="paper all")
    )
    save_run(directory, replace(RUN, experiment=replace(RUN.experiment, repetitions=1)))
    assert [(trial.scheme, trial.repetition) for trial in load_run(directory).trials] == [("utility all", 1)]


def test_a_second_write_leaves_nothing_beside_the_file(tmp_path: Path) -> None:
    directory = a_run(a_run(tmp_path / "run", TRIAL), TRIAL)
    assert sorted(path.name for path in directory.rglob("*.json*")) == ["run.json", "utility-all-2.json"]


@pytest.mark.parametrize(
    "damage",
    [b"", b"{", b"[]", b"\xff", b'{"format_version": 1}', b'{"format_version": 1, "scheme": "local"}'],
)
def test_a_damaged_trial_is_refused_where_it_is_read_and_made_again_where_the_run_goes_on(
    tmp_path: Path, damage: bytes
) -> None:
    directory = a_run(tmp_path / "run", replace(TRIAL, repetition=1), TRIAL)
    path = directory / "trials" / "utility-all-1.json"
    path.write_bytes(damage)
    with pytest.raises(FileError, match=r"utility-all-1\.json is damaged") as caught:
        load_run(directory)
    assert caught.value.hint
    said: list[str] = []
    again = load_run_to_resume(directory, said.append)
    assert again is not None
    assert again.trials == (TRIAL,)
    assert (len(said), path.exists(), path.with_name("utility-all-1.json.broken-1").read_bytes()) == (
        1,
        False,
        damage,
    )
    assert load_run(directory).trials == (TRIAL,)


def test_a_trial_under_another_s_name_is_damaged(tmp_path: Path) -> None:
    directory = a_run(tmp_path / "run", TRIAL)
    (directory / "trials" / "utility-all-2.json").rename(directory / "trials" / "utility-all-1.json")
    with pytest.raises(FileError, match="it holds utility all, repetition 2"):
        load_run(directory)


def test_what_is_no_run_is_said(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no run in"):
        load_run(tmp_path)
    assert load_run_to_resume(tmp_path / "new", print) is None
    assert load_run_to_resume(tmp_path, print) is None
    (tmp_path / "trials").mkdir()
    (tmp_path / "run.json.tmp").touch()
    assert load_run_to_resume(tmp_path, print) is None, "it was cut off before the first byte"
    (tmp_path / "mine.txt").touch()
    with pytest.raises(FileError, match="is not empty"):
        load_run_to_resume(tmp_path, print)
    directory = a_run(tmp_path / "run")
    (directory / "run.json").write_text("{}")
    for read in (load_run, lambda path: load_run_to_resume(path, print)):
        with pytest.raises(
            FileError, match=r"run\.json is damaged: not a valid run: format_version is missing"
        ):
            read(directory)
    (directory / "run.json").write_text('{"format_version": 2}')
    with pytest.raises(StateError, match="newer edgectl"):
        load_run(directory)


def test_the_newest_run_is_the_one_begun_or_extended_last(tmp_path: Path) -> None:
    assert find_newest_run(tmp_path / "runs") is None
    for age, name in ((2, "a"), (1, "c"), (3, "b")):
        path = a_run(tmp_path / "runs" / name) / "run.json"
        os.utime(path, (1e9 - age, 1e9 - age))
    assert find_newest_run(tmp_path / "runs") == tmp_path / "runs" / "c"
