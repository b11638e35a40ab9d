"""The second chance of ``make test``: it names what it forgave, and forgives nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import LONGEST

ROOT = Path(__file__).parents[1]
ONCE = """
import os, pathlib, pytest
def runs(name):
    with open(name, "a") as note:
        note.write("x")
    return len(pathlib.Path(name).read_text())
"""
FINE = "def test_fine(): pass\n"


def suite(directory: Path, tests: str, *options: str) -> tuple[int, str]:
    """Exit status and output of the suite over one file of tests."""
    (directory / "pytest.ini").write_text("[pytest]\naddopts = -q\n")
    (directory / "test_it.py").write_text(ONCE + tests)
    words = [sys.executable, "-m", "tests.suite", "test_it.py", *options]
    env = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(
        words,
        cwd=directory,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


def fails_once(name: str) -> str:
    return f"def test_{name}(): assert runs('{name}') > 1\n"


def test_what_passes_is_run_once(tmp_path: Path) -> None:
    code, said = suite(tmp_path, "def test_a(): assert runs('a') == 1\n")
    assert (code, "alone" in said.lower()) == (0, False), said
    assert (tmp_path / "a").read_text() == "x"


@pytest.mark.parametrize("options", [(), ("-p", "xdist", "-n", "2", "--dist", "loadfile")])
def test_what_passes_alone_is_named(tmp_path: Path, options: tuple[str, ...]) -> None:
    tests = "@pytest.mark.parametrize('command', ['ssh-sleep 0.2; exit 3::[x]'])\ndef test_once(command): assert runs('once') > 1\n"
    code, said = suite(tmp_path, FINE + tests, *options)
    assert code == 0, said
    assert (
        said.splitlines()[-1]
        == "FAILED FIRST, PASSED ALONE: look at it: test_it.py::test_once[ssh-sleep 0.2; exit 3::[x]]"
    )
    assert "1 failed, 1 passed" in said, "the first run's own words stay"
    assert (tmp_path / "once").read_text() == "xx"


def test_what_fails_twice_fails(tmp_path: Path) -> None:
    code, said = suite(tmp_path, fails_once("once") + "def test_never(): assert runs('never') > 2\n")
    assert code == 1
    assert said.splitlines()[-2:] == [
        "FAILED FIRST, PASSED ALONE: look at it: test_it.py::test_once",
        "FAILED TWICE: test_it.py::test_never",
    ]
    assert (tmp_path / "never").read_text() == "xx", "there is no third chance"


def test_more_than_three_are_no_accident(tmp_path: Path) -> None:
    code, _ = suite(tmp_path, "".join(map(fails_once, "abcd")))
    assert code == 1
    assert [(tmp_path / name).read_text() for name in "abcd"] == ["x"] * 4


def test_a_failed_teardown_counts(tmp_path: Path) -> None:
    fixture = (
        "@pytest.fixture\ndef left():\n    yield\n    assert runs('left') > {}\ndef test_left(left): pass\n"
    )
    assert suite(tmp_path, fixture.format(1))[0] == 0
    (tmp_path / "left").unlink()
    assert suite(tmp_path, fixture.format(2))[0] == 1


@pytest.mark.parametrize("options", [("-n", "2"), ("--continue-on-collection-errors",)])
def test_a_file_that_cannot_be_read_is_not_forgiven(tmp_path: Path, options: tuple[str, ...]) -> None:
    """pytest-xdist runs the tests of the others."""
    (tmp_path / "test_broken.py").write_text("import no_such_module\n")
    code, said = suite(tmp_path, fails_once("once"), "test_broken.py", "-p", "xdist", *options)
    assert code != 0, said
    assert "PASSED ALONE" not in said
    assert (tmp_path / "once").read_text() == "x"


@pytest.mark.parametrize(
    ("tests", "options"),
    [
        ("def test_it():\n    if runs('it') > 1: pytest.skip('no')\n    raise AssertionError\n", ()),
        ("def test_it():\n    if runs('it') == 1: os._exit(3)\n", ("-p", "xdist", "-n", "1")),
        ("assert runs('it') > 1\ndef test_it(): pass\n", ()),
        (fails_once("it") + "def test_left_out(): assert False\n", ("-x",)),
        ("", ()),
    ],
    ids=["a skip", "a crash", "a file that cannot be read", "a run cut short", "no test"],
)
def test_everything_else_fails(tmp_path: Path, tests: str, options: tuple[str, ...]) -> None:
    code, said = suite(tmp_path, tests, *options)
    assert code != 0, said
    assert "PASSED ALONE" not in said


def test_the_files_that_are_begun_first_are_there() -> None:
    assert [name for name in LONGEST if not (ROOT / "tests" / name).exists()] == []
