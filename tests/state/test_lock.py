# SPDX-License-Identifier: Apache-2.0
"""One holder at a time; the lock is released when its holder dies."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from edgectl.errors import LockBusyError
from edgectl.state.lock import FleetLock
from tests.pace import patience

HOLDER = """
import sys, time, subprocess
from pathlib import Path
from edgectl.state.lock import FleetLock
with FleetLock(Path(sys.argv[1]), verb="apply"):
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(30)"], close_fds=False)
    print(child.pid, flush=True)
    time.sleep(30)
"""


def hold_lock(directory: Path) -> tuple[subprocess.Popen[str], int]:
    """Start a process that holds the lock, with a child that must not inherit it."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(directory)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    with process.stdout as out:
        return process, int(out.readline())


def test_a_second_one_is_told_who_holds_it(tmp_path: Path) -> None:
    with (
        FleetLock(tmp_path, verb="apply", clock=lambda: 0.0),
        pytest.raises(LockBusyError) as caught,
        FleetLock(tmp_path),
    ):
        pass
    assert f"(pid {os.getpid()}, apply, since 1970-01-01T00:00:00Z)" in caught.value.message
    assert caught.value.exit_code == 75


def test_it_is_free_after_use_and_after_a_failure(tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(KeyError), FleetLock(tmp_path):
            raise KeyError
    assert (tmp_path / "lock").stat().st_mode & 0o777 == 0o600


def test_it_dies_with_its_holder_and_is_not_inherited(tmp_path: Path) -> None:
    process, child = hold_lock(tmp_path)
    try:
        with pytest.raises(LockBusyError, match=f"pid {process.pid}"), FleetLock(tmp_path):
            pass
        process.kill()
        process.wait()
        with FleetLock(tmp_path):
            os.kill(child, 0)  # the child is alive, without the lock
    finally:
        process.kill()
        process.wait()
        os.kill(child, signal.SIGKILL)


def test_a_timeout_waits_for_the_holder(tmp_path: Path) -> None:
    process, child = hold_lock(tmp_path)

    def kill_later() -> None:
        time.sleep(0.3)
        process.kill()

    try:
        with ThreadPoolExecutor(1) as pool:
            began = time.monotonic()
            pool.submit(kill_later)
            with FleetLock(tmp_path, timeout=30.0):
                assert 0.2 < time.monotonic() - began < patience(25)
    finally:
        process.kill()
        process.wait()
        os.kill(child, signal.SIGKILL)


def test_of_many_at_once_one_wins(tmp_path: Path) -> None:
    script = (
        "import sys, time\nfrom pathlib import Path\nfrom edgectl.errors import LockBusyError\nfrom edgectl.state.lock import FleetLock\n"
        "try:\n    with FleetLock(Path(sys.argv[1])):\n        print('won', flush=True)\n        sys.stdin.read()\n"
        "except LockBusyError:\n    print('busy', flush=True)\n"
    )
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", script, str(tmp_path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(8)
    ]
    said = []
    for process in processes:
        assert process.stdout is not None
        said.append(process.stdout.readline().strip())
    for process in processes:
        process.communicate(timeout=120)
    assert sorted(said) == ["busy"] * 7 + ["won"]
