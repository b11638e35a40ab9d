# SPDX-License-Identifier: Apache-2.0
"""Lazy imports: a command imports heavy packages only if it needs them."""

import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = {
    "highspy",
    "numpy",
    "fabric",
    "paramiko",
    "invoke",
    "rich",
    "pydantic",
    "yaml",
    "psutil",
    "cryptography",
    "asyncio",
    "prometheus_client",
    "textual",
    "http",
    "sqlite3",
    "matplotlib",
    "jinja2",
}


def list_imports(site: Path, *words: str) -> set[str]:
    """Return the top-level packages that a command imports."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "edgectl", *words],
        cwd=site,
        capture_output=True,
        text=True,
        check=True,
    )
    return {
        line.rpartition("|")[2].strip().partition(".")[0]
        for line in done.stderr.splitlines()
        if line.startswith("import time:")
    }


@pytest.mark.parametrize(
    "words",
    [
        ("--help",),
        ("plan", "--help"),
        ("apply", "--help"),
        ("version",),
        ("--version",),
        ("completion", "bash"),
        ("export", "prometheus", "--help"),
        ("events", "--help"),
        ("report", "--help"),
    ],
)
def test_help_needs_nothing_heavy(site: Path, words: tuple[str, ...]) -> None:
    assert not list_imports(site, *words) & HEAVY


def test_a_plan_from_a_snapshot_needs_no_ssh_and_no_colours(site: Path) -> None:
    found = list_imports(site, "plan", "--snapshot", "snap.json")
    assert "yaml" in found
    assert not found & (HEAVY - {"yaml"})


def test_a_local_fleet_needs_no_ssh(site: Path) -> None:
    assert not list_imports(site, "probe", "-o", "name") & {
        "fabric",
        "paramiko",
        "invoke",
        "cryptography",
        "prometheus_client",
        "textual",
    }


COLLECTIONS = """
import gc, sys
from edgectl.cli.main import main
usual = gc.get_threshold()
def count():
    return sum(each["collections"] for each in gc.get_stats())
before = count()
for _ in range(2):
    main(["plan", "--snapshot", "snap.json"])
print(count() - before, len(gc.callbacks), file=sys.stderr)
kept = [[] for _ in range(300_000)]
print(count() > before, gc.get_threshold() == usual, len(gc.callbacks), file=sys.stderr)
gc.disable()
main(["version"])
print(gc.isenabled(), file=sys.stderr)
"""


def test_no_garbage_is_collected_during_a_start_and_it_is_afterwards(site: Path) -> None:
    command = [sys.executable, "-c", COLLECTIONS]
    done = subprocess.run(command, cwd=site, capture_output=True, text=True, check=True)
    assert done.stderr.split()[-6:] == ["0", "1", "True", "True", "0", "False"]


# Says when Python takes its object apart, and what else happens at the end.
LAST_WORDS = """
import atexit, os, sys, threading, time, weakref
from edgectl.cli.main import run
class Loud:
    def __del__(self, write=os.write):
        write(1, b"taken apart")
sys.kept = Loud()
weakref.finalize(run, print, "finalized")
atexit.register(print, "registered")
threading.Thread(target=lambda: time.sleep(0.3) or print("waited")).start()
sys.argv = ["edgectl", "plan", "--no-such-option"]
run()
"""


def test_nothing_is_taken_apart_at_the_end_but_all_that_was_registered_is_called() -> None:
    done = subprocess.run([sys.executable, "-c", LAST_WORDS], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (64, ["waited", "registered", "finalized"])
    assert "no-such-option" in done.stderr
    assert "ignored" not in done.stderr


def test_last_words_that_cannot_be_written_are_an_error() -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-c", LAST_WORDS]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    # Python's own exit code for this.
    assert done.returncode == 120
    assert "No space left on device" in done.stderr
