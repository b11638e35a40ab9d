# SPDX-License-Identifier: Apache-2.0
"""Forked processes of edgectl: what they print, return and inherit, and how they end."""

import json
import os
import select
import signal
import subprocess
from pathlib import Path

import pytest

from tests.cli.terminal import Terminal
from tests.forkserver import EDGECTL, ForkedProcess
from tests.pace import patience

ENV = {"PATH": os.defpath, "MARK": "ours"}


def run(program: str, *words: str) -> tuple[int, str, str]:
    process = ForkedProcess(words, program=program, env=ENV, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, err = process.communicate(timeout=patience(60))
    return process.returncode, out, err


def test_it_prints_and_returns_what_a_started_edgectl_does(tmp_path: Path) -> None:
    code, out, err = run(EDGECTL, "--version")
    assert (code, out.split()[0], err) == (0, "edgectl", "")
    code, _, err = run(EDGECTL, "validate", "-i", str(tmp_path / "none.yaml"))
    assert code == 64
    assert err.startswith("error: ")


def test_it_has_an_environment_a_session_and_files_of_its_own() -> None:
    program = """
import json, os, sys
same = [os.getpid() == os.getsid(0), os.getcwd(), sys.stdin.read(), sorted(os.listdir("/proc/self/fd"))]
print(json.dumps([dict(os.environ), *same]))
os.system("echo $MARK >&2")
"""
    code, out, err = run(program)
    environment, leads, directory, read, files = json.loads(out)
    assert (code, environment, leads, directory, read, err) == (0, ENV, True, str(Path.cwd()), "", "ours\n")
    assert len(files) == 4, "the standard streams, and the directory that is listed"


def test_it_is_killed_and_waited_for_like_any_process() -> None:
    process = ForkedProcess([], program="import time; time.sleep(600)", env=ENV)
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait(patience(30)) == -signal.SIGKILL
    assert not Path(f"/proc/{process.pid}").exists()
    process.end()


def test_what_it_raises_is_told_and_its_exit_code_is_1() -> None:
    code, _, err = run("1 / 0")
    assert code == 1
    assert "ZeroDivisionError" in err


def test_its_streams_are_buffered_and_read_like_those_of_a_started_one() -> None:
    program = "import sys; print(sys.stdin.readline().upper(), end=''); sys.stderr.write('said\\n'); sys.stdin.read()"
    with ForkedProcess(
        [], program=program, env=ENV, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdin.write("word\n")
        process.stdin.flush()
        assert process.stderr.readline() == "said\n"
        assert not select.select([process.stdout], [], [], 0.1)[0], "a pipe is written at the end"
        process.stdin.close()
        assert process.stdout.read() == "WORD\n"
        assert process.wait(patience(30)) == 0


def test_a_reader_that_is_gone_and_a_terminal(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with ForkedProcess([], program="print('x')", env=ENV, stdout=writing, stderr=subprocess.PIPE) as process:
        os.close(writing)
        assert "BrokenPipeError" in process.communicate(timeout=patience(30))[1]
        assert process.returncode == 120
    with Terminal([], tmp_path, program="import time; print('shown'); time.sleep(600)") as terminal:
        terminal.until("shown")
