"""Every example of every command's help, run as it stands, in the order in which a person would come to it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from edgectl.cli.app import COMMANDS, split_docstring
from tests.cli.terminal import Terminal
from tests.docs.blocks import stopped

DOCS = Path(__file__).parents[2] / "docs"
ENDLESS = ("edgectl logs slam-robot1 -f",)
SERVING = ("edgectl export prometheus --listen 127.0.0.1:9815",)
WATCHING = ("edgectl watch --apply --every 30s",)
ASKING = ("edgectl apply", "edgectl drain edge1", "edgectl rollback")
BUSY = 75  # the demo's tasks run
FULL = 4  # the other edges of the demo have no room for all that runs on edge1
CODES = {
    "edgectl plan --without edge2 --detailed-exitcode": 2,
    "edgectl profile slam-robot1 --write --yes": 1,  # too few samples after these few commands
    "edgectl drain edge1": FULL,
    "edgectl experiment run tasks/mission/experiment.yaml": BUSY,
    "edgectl experiment run tasks/mission/experiment.yaml -n 1 --out again": BUSY,
    "edgectl drain edge1 --yes --timeout 10m": FULL,
}
FIRST = ("edgectl init demo", "edgectl init .")
EARLY = ("edgectl plan --out next.plan", "edgectl show next.plan", "edgectl apply next.plan")
LATE = ("edgectl rollback", "edgectl drain", "edgectl stop")


def examples() -> list[str]:
    from importlib import import_module

    found: list[str] = []
    for name, entry in COMMANDS.items():
        function = getattr(import_module(f"edgectl.{entry.module}"), f"{name.replace(' ', '_')}_command")
        found += [line.strip() for line in split_docstring(function)[1].splitlines()]
    early = [line for start in EARLY for line in found if line.startswith(start)]
    late = [line for start in LATE for line in found if line.startswith(start)]
    middle = [line for line in found if line not in (*FIRST, *early, *late)]
    return [*early, *middle, *late]


def run(line: str, site: Path, env: dict[str, str]) -> int:
    words = [sys.executable, "-m", *line.split()]
    if line in ASKING:
        with Terminal(words, site, env=env) as terminal:
            terminal.type("yes\n")
            return terminal.wait()
    if line in WATCHING:
        with Terminal(words, site, env=env) as terminal:
            terminal.until("next in")
            terminal.type("q")
            return terminal.wait()
    if line in ENDLESS:
        process = subprocess.Popen(
            words, cwd=site, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert process.stdout is not None
        with process.stdout as lines:
            assert any(b"alive" in lines.readline() for _ in range(3))
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 130
        return 0
    if "-w" in words:
        return watch(words, site, env)
    if line in SERVING:
        return serve([word.replace(":9815", ":0") for word in words], site, env)
    return subprocess.run(
        words,
        cwd=site,
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        check=False,
        timeout=300,
    ).returncode


def watch(words: list[str], site: Path, env: dict[str, str]) -> int:
    """Until it has shown something."""
    process = subprocess.Popen(words, cwd=site, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    with process.stdout as lines:
        assert lines.readline()
        process.send_signal(signal.SIGINT)
        return process.wait(30)


def serve(words: list[str], site: Path, env: dict[str, str]) -> int:
    """On a free port, until it serves."""
    process = subprocess.Popen(words, cwd=site, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    with process.stderr as said:
        assert b"serving http" in said.readline()
        process.send_signal(signal.SIGINT)
        return process.wait(30)


@pytest.mark.timeout(1800)  # a hundred commands; a busy machine takes minutes
def test_every_example_runs(tmp_path: Path) -> None:
    env = {**os.environ, "EDGECTL_STATE_DIR": str(tmp_path / "state"), "COLUMNS": "80", "TERM": "xterm"}
    site = tmp_path / "demo"
    for line, where in (("edgectl init demo", tmp_path), ("edgectl init .", site)):
        assert run(line, where, env) == 0
    (site / "docs").symlink_to(DOCS)
    with stopped(site, env):
        failed = {line: code for line in examples() if (code := run(line, site, env)) != CODES.get(line, 0)}
        assert failed == {}
