"""Forked processes of edgectl: what they print, return and inherit, and how they end."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.forkserver import EDGECTL, ForkedProcess
from tests.pace import patience

ENV = {"PATH": os.defpath, "MARK": "ours"}


def run(program: str, *words: str) -> tuple[int, str, str]:
    process = ForkedProcess(["edgectl", *words], program=program, env=ENV)
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
    process = ForkedProcess(["edgectl"], program="import time; time.sleep(600)", env=ENV)
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
