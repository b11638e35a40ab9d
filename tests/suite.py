# SPDX-License-Identifier: Apache-2.0
"""Run the suite, then up to three failed tests once more, alone: ``python -m tests.suite PYTEST-ARGUMENTS`` (ADR 0030).

A test that passes in the second run is named at the end; any other result of it fails the suite.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

# More failures are no accident, and nothing is run again.
MOST = 3
ALONE = "--alone"
PHASES = ("setup", "call", "teardown")
# Syncing and removing thousands of small files takes minutes on a slow disk.
MEMORY, ROOM_BYTES = Path("/dev/shm"), 1 << 30


class Seen:
    """What came of the tests of one run; ``final`` where a failure is none of a single test."""

    def __init__(self) -> None:
        self.passed: set[str] = set()
        self.failed: dict[str, None] = {}
        self.final = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed[report.nodeid] = None
            # A worker that died reports for its test, in no phase.
            self.final |= report.when not in PHASES
        elif report.passed and report.when == "call":
            self.passed.add(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self.final |= report.failed

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """A run that was cut short (``-x``) says nothing of the tests that it left out."""
        self.final |= bool(session.shouldfail or session.shouldstop)


def everything(arguments: Sequence[str]) -> int:
    """Run the suite; exit status of pytest, or 0 where each test that failed passed alone."""
    seen = Seen()
    code = int(pytest.main([*arguments], plugins=[seen]))
    if code != pytest.ExitCode.TESTS_FAILED or seen.final or not seen.failed:
        return code
    if len(seen.failed) > MOST:
        print(f"\n== {len(seen.failed)} tests failed: more than {MOST}, so none was run again", flush=True)
        return code
    print(f"\n== once more, alone: {len(seen.failed)} of the tests above", flush=True)
    again = [
        test
        for test in seen.failed
        if subprocess.run([sys.executable, "-m", __spec__.name, ALONE, test], check=False).returncode
    ]
    print()
    for test in seen.failed:
        print(f"FAILED TWICE: {test}" if test in again else f"FAILED FIRST, PASSED ALONE: look at it: {test}")
    return int(pytest.ExitCode.TESTS_FAILED if again else pytest.ExitCode.OK)


def alone(test: str) -> int:
    """Run one test; 0 only where it passed: a skip is no second chance."""
    seen = Seen()
    code = int(pytest.main([test], plugins=[seen]))
    return code or int(test not in seen.passed)


def prepare() -> None:
    """Put temporary files into memory if there is room and TMPDIR is not set, and let Python cache bytecode.

    The tests start hundreds of Python processes; without cached bytecode each would compile all of edgectl.
    """
    if (
        "TMPDIR" not in os.environ
        and os.access(MEMORY, os.W_OK)
        and shutil.disk_usage(MEMORY).free > ROOM_BYTES
    ):
        os.environ["TMPDIR"] = str(MEMORY)
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False


if __name__ == "__main__":
    prepare()
    words = sys.argv[1:]
    sys.exit(alone(words[1]) if words[:1] == [ALONE] else everything(words))
