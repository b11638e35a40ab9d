# SPDX-License-Identifier: Apache-2.0
"""The command as a process: two at once, Ctrl-C, exit codes."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.state.paths import get_state_root
from tests.compiled_agent import give_agent_and_keys
from tests.e2e.bench import a_mark, list_sleepers, wait_for_sleepers
from tests.forkserver import ForkedProcess, run_edgectl
from tests.pace import patience

INVENTORY = """
version: 1
edges:
  edge1: {host: 127.0.0.33, connection: local, capacity: {cpu: 2, memory: 1Gi}}
  edge2: {host: 127.0.0.34, connection: local, capacity: {cpu: 2, memory: 1Gi}}
"""
TASKS = """
version: 1
tasks:
  slam: {command: "sleep MARK", demand: {cpu: 0.5, memory: 10Mi}, stop: {grace: 2s}, ready: {command: test -e GO, timeout: 60s}}
  navigation: {command: "sleep MARK", up: 300ms, needs: [slam], demand: {cpu: 0.5, memory: 10Mi}, stop: {grace: 2s}}
"""


class Shell:
    """A directory with a fleet, in which edgectl is called."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.mark = a_mark()
        (directory / "inventory.yaml").write_text(INVENTORY)
        (directory / "tasks.yaml").write_text(
            TASKS.replace("MARK", self.mark).replace("GO", str(directory / "go"))
        )

    def command(self, *words: str) -> list[str]:
        return [*words, "-i", "inventory.yaml", "-t", "tasks.yaml"]

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        return run_edgectl(*self.command(*words), cwd=self.directory, timeout=patience(60))

    def begin(self, *words: str) -> subprocess.Popen[str]:
        """Start a command and wait until the first task runs, not ready yet."""
        process = ForkedProcess(
            self.command(*words), cwd=self.directory, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        deadline = time.monotonic() + patience(40)
        while not list_sleepers(self.mark):
            assert time.monotonic() < deadline
            assert process.poll() is None, process.communicate()
            time.sleep(0.05)
        return process

    def interrupted(self, process: subprocess.Popen[str], number: signal.Signals) -> None:
        """Send a signal, and wait until it was handled."""
        os.kill(process.pid, number)
        assert process.stderr is not None
        assert "finishing the running actions" in next(line for line in process.stderr if "finishing" in line)

    def go(self) -> None:
        """Let slam become ready."""
        (self.directory / "go").touch()


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    made = Shell(tmp_path)
    give_agent_and_keys(get_state_root(), tmp_path / "inventory.yaml")
    yield made
    made.run("stop", "--all", "--yes")
    assert list_sleepers(made.mark) == []


def test_the_second_of_two_applies_exits_75(shell: Shell) -> None:
    first = shell.begin("apply", "--yes")
    second = shell.run("apply", "--yes")
    assert second.returncode == 75
    assert f"(pid {first.pid}, apply, since " in second.stderr
    shell.go()
    out, _ = first.communicate(timeout=patience(60))
    assert first.returncode == 0, out
    assert len(wait_for_sleepers(shell.mark)) == 2
    quiet = shell.run("apply", "--yes", "--quiet")
    assert (quiet.returncode, quiet.stdout) == (0, "")


def test_a_lock_timeout_waits_for_the_first(shell: Shell) -> None:
    first = shell.begin("apply", "--yes")
    second = ForkedProcess(
        shell.command("apply", "--yes", "--lock-timeout", "60s"),
        cwd=shell.directory,
        stdout=subprocess.DEVNULL,
    )
    time.sleep(0.5)
    shell.go()
    first.communicate(timeout=patience(60))
    assert (first.returncode, second.wait(timeout=patience(60))) == (0, 0)
    assert len(wait_for_sleepers(shell.mark)) == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_finish_what_is_under_way(shell: Shell, number: signal.Signals) -> None:
    process = shell.begin("apply", "--yes")
    shell.interrupted(process, number)
    shell.go()
    out, errors = process.communicate(timeout=patience(60))
    assert process.returncode == 130, out + errors
    assert len(list_sleepers(shell.mark)) == 1
    assert "interrupted" in shell.run("history").stdout
    again = shell.run("apply", "--yes")
    assert again.returncode == 0, again.stderr
    assert "cut off" not in again.stderr
    assert len(wait_for_sleepers(shell.mark)) == 2


def test_ctrl_c_twice_stops_at_once_and_the_next_apply_goes_on(shell: Shell) -> None:
    process = shell.begin("apply", "--yes")
    shell.interrupted(process, signal.SIGINT)
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=patience(40))  # no wait: slam has a minute to get ready
    assert process.returncode == 130
    shell.go()
    again = shell.run("apply", "--yes")
    assert again.returncode == 0, again.stderr
    assert "was interrupted while it changed slam" in again.stderr
    assert len(wait_for_sleepers(shell.mark)) == 2
