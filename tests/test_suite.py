# SPDX-License-Identifier: Apache-2.0
"""The second run of failed tests in ``make test``, and the hooks of ``tests/conftest.py``."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import LONGEST
from tests.e2e.bench import a_mark, list_sleepers
from tests.pace import measure

ROOT = Path(__file__).parents[1]
ONCE = """
import os, pathlib, pytest
def runs(name):
    with open(name, "a") as note:
        note.write("x")
    return len(pathlib.Path(name).read_text())
"""
FINE = "def test_fine(): pass\n"


def run_suite(
    directory: Path, tests: str, *options: str, module: str = "tests.suite", deaf: bool = False, **more: str
) -> tuple[int, str]:
    """Exit status and output of the suite over one file of tests; ``deaf``: started with SIGINT ignored."""
    (directory / "pytest.ini").write_text("[pytest]\naddopts = -q\n")
    (directory / "test_it.py").write_text(ONCE + tests)
    words = [sys.executable, "-m", module, "test_it.py", *options]
    env = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", **more}
    words = ["sh", "-c", "trap '' INT; exec \"$@\"", "sh", *words] if deaf else words
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
    code, said = run_suite(tmp_path, "def test_a(): assert runs('a') == 1\n")
    assert (code, "alone" in said.lower()) == (0, False), said
    assert (tmp_path / "a").read_text() == "x"


@pytest.mark.parametrize("options", [(), ("-p", "xdist", "-n", "2", "--dist", "loadfile")])
def test_what_passes_alone_is_named(tmp_path: Path, options: tuple[str, ...]) -> None:
    tests = "@pytest.mark.parametrize('command', ['ssh-sleep 0.2; exit 3::[x]'])\ndef test_once(command): assert runs('once') > 1\n"
    code, said = run_suite(tmp_path, FINE + tests, *options)
    assert code == 0, said
    assert (
        said.splitlines()[-1]
        == "FAILED FIRST, PASSED ALONE: look at it: test_it.py::test_once[ssh-sleep 0.2; exit 3::[x]]"
    )
    assert "1 failed, 1 passed" in said, "the first run's own words stay"
    assert (tmp_path / "once").read_text() == "xx"


def test_what_fails_twice_fails(tmp_path: Path) -> None:
    code, said = run_suite(tmp_path, fails_once("once") + "def test_never(): assert runs('never') > 2\n")
    assert code == 1
    assert said.splitlines()[-2:] == [
        "FAILED FIRST, PASSED ALONE: look at it: test_it.py::test_once",
        "FAILED TWICE: test_it.py::test_never",
    ]
    assert (tmp_path / "never").read_text() == "xx", "there is no third chance"


def test_more_than_three_are_no_accident(tmp_path: Path) -> None:
    code, said = run_suite(tmp_path, "".join(map(fails_once, "abcd")))
    assert code == 1
    assert said.splitlines()[-1] == "== 4 tests failed: more than 3, so none was run again"
    assert [(tmp_path / name).read_text() for name in "abcd"] == ["x"] * 4


def test_a_failed_teardown_counts(tmp_path: Path) -> None:
    fixture = (
        "@pytest.fixture\ndef left():\n    yield\n    assert runs('left') > {}\ndef test_left(left): pass\n"
    )
    assert run_suite(tmp_path, fixture.format(1))[0] == 0
    (tmp_path / "left").unlink()
    assert run_suite(tmp_path, fixture.format(2))[0] == 1


@pytest.mark.parametrize("options", [("-n", "2"), ("--continue-on-collection-errors",)])
def test_a_file_that_cannot_be_read_is_not_forgiven(tmp_path: Path, options: tuple[str, ...]) -> None:
    """pytest-xdist runs the tests of the others."""
    (tmp_path / "test_broken.py").write_text("import no_such_module\n")
    code, said = run_suite(tmp_path, fails_once("once"), "test_broken.py", "-p", "xdist", *options)
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
    code, said = run_suite(tmp_path, tests, *options)
    assert code != 0, said
    assert "PASSED ALONE" not in said


def test_workers_find_the_modules_of_the_tests_imported(tmp_path: Path) -> None:
    tests = "assert runs('imports') == 1, __name__\ndef test_one(): runs('one')\ndef test_other(): runs('other')\n"
    options = ("-p", "tests.conftest", "-p", "xdist", "-n", "2", "--dist", "load")
    code, said = run_suite(tmp_path, tests, *options)
    assert (code, "2 passed" in said) == (0, True), said
    assert [(tmp_path / name).read_text() for name in ("imports", "one", "other")] == ["x"] * 3


def test_a_worker_that_dies_is_told_and_its_tests_go_on_in_another(tmp_path: Path) -> None:
    tests = "def test_dies(): os._exit(3)\ndef test_two(): pass\ndef test_three(): pass\n"
    options = ("-p", "tests.conftest", "-p", "xdist", "-n", "2", "--dist", "load")
    code, said = run_suite(tmp_path, tests, *options)
    assert (code, "1 failed, 2 passed" in said) == (1, True), said
    assert "crashed while running 'test_it.py::test_dies'" in said


def test_the_files_that_are_begun_first_are_there() -> None:
    assert [name for name in LONGEST if not (ROOT / "tests" / name).exists()] == []


@pytest.mark.parametrize("options", [(), ("-p", "xdist", "-n", "2")], ids=["here", "in a worker"])
def test_ctrl_c_reaches_what_tests_start(tmp_path: Path, options: tuple[str, ...]) -> None:
    tests = """
import signal, subprocess, sys
def test_it():
    child = [sys.executable, "-c", "import signal, time; print(1, flush=True); time.sleep(3)"]
    with subprocess.Popen(child, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == -signal.SIGINT
"""
    assert run_suite(tmp_path, tests, "-p", "tests.conftest", *options, module="pytest", deaf=True)[0] == 0
    assert run_suite(tmp_path, tests, module="pytest", deaf=True)[0] == 1, "nothing else gives it back"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_a_failed_test_started_is_ended_before_its_neighbour_begins(tmp_path: Path) -> None:
    mark = a_mark()
    tests = f"""
import subprocess
def leave(tmp_path):
    return subprocess.run(["sh", "-c", "setsid sleep {mark} & echo $!"], cwd=tmp_path, stdout=open(tmp_path / "pid", "w"))
def of_the_neighbours():
    return subprocess.run(["pgrep", "-f", "^sleep {mark}"], capture_output=True, text=True).stdout.split()
def test_fails(tmp_path):
    leave(tmp_path)
    assert not of_the_neighbours()
def test_neighbour(tmp_path):
    assert not of_the_neighbours()
    leave(tmp_path)
"""
    code, said = run_suite(tmp_path, tests, "-p", "tests.conftest", module="pytest")
    assert (code, "1 failed, 1 passed" in said) == (1, True), said
    assert list_sleepers(mark) == [], "what the other left ends with the session"


def test_limits_follow_the_pace(tmp_path: Path) -> None:
    tests = "import time\ndef test_it(): time.sleep(1.5)\n"
    options = ("-p", "tests.conftest", "-p", "pytest_timeout", "-o", "timeout=1")
    assert run_suite(tmp_path, tests, *options, module="pytest", TESTS_PACE="1.00")[0] == 1
    assert run_suite(tmp_path, tests, *options, module="pytest", TESTS_PACE="9.00")[0] == 0
    assert measure() >= 1.0
