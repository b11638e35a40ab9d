# SPDX-License-Identifier: Apache-2.0
"""watch on a terminal and under systemd: keys, signals, edited files. On real local hosts."""

import json
import os
import signal
import subprocess
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.cli.main import main
from tests.cli.conftest import Run
from tests.cli.terminal import Terminal
from tests.compiled_agent import give_agent_and_keys
from tests.forkserver import ForkedProcess
from tests.pace import patience

INVENTORY = """\
version: 1
fleet: one
defaults: {connection: local}
edges:
  edge1: {host: localhost, capacity: {cpu: 4, memory: 1Gi}}
"""
TASKS = """\
version: 1
tasks:
  idle: {command: sleep 600, demand: {cpu: 0.01, memory: 1Mi}}
"""
SLOW = TASKS.replace("command: sleep 600", 'command: sleep 600, ready: {command: "sleep 3", timeout: 30s}')
LIMIT_S = patience(60.0)


def read_entries(state: Path) -> list[dict[str, object]]:
    """Read the entries of the journal."""
    return [
        json.loads(line[65:])
        for path in state.glob("fleets/*/journal.jsonl")
        for line in path.read_text().splitlines()
    ]


@pytest.fixture
def one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A fleet of one edge, a slice of this machine, with one idle task, as the working directory; nothing
    runs on afterwards.
    """
    for name, text in (("inventories/one.yaml", INVENTORY), ("tasks/one.yaml", TASKS)):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    give_agent_and_keys(tmp_path / "state", tmp_path / "inventories" / "one.yaml")
    yield tmp_path
    if read_entries(tmp_path / "state"):
        assert main(["stop", "--all", "--yes", "-o", "name"]) == 0


def watch_command(*more: str) -> list[str]:
    return ["watch", *more]


def read_terminal_modes(terminal: Terminal) -> tuple[int, int]:
    """Return the terminal's input and local modes: line editing and echo."""
    attributes = termios.tcgetattr(terminal._ours)
    return attributes[0], attributes[3]


def test_keys_plan_now_pause_and_quit(one: Path) -> None:
    with Terminal(watch_command("--apply", "--every", "1h"), one) as terminal:
        before = read_terminal_modes(terminal)
        terminal.until("task-started idle on edge1")
        terminal.type("p")
        terminal.until("steady 1 cycle")
        assert not read_terminal_modes(terminal)[1] & termios.ICANON, "keys come one by one"
        terminal.type("xP")
        terminal.until("steady 2 cycles")
        terminal.type("a")
        terminal.until("paused")
        terminal.type("q")
        assert terminal.wait() == 0
        assert read_terminal_modes(terminal) == before
    assert "weights all · applies · next in " in terminal.seen
    assert "\x1b[?1049l" in terminal.seen.rpartition("\x1b[?1049h")[2], "the screen from before is back"
    assert "\x1b[?25h" in terminal.seen.rpartition("\x1b[?25l")[2], "and the cursor"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_a_signal_ends_it_and_the_terminal_is_as_before(one: Path, number: signal.Signals, code: int) -> None:
    with Terminal(watch_command("--every", "1h"), one, env={**os.environ, "NO_COLOR": "1"}) as terminal:
        before = read_terminal_modes(terminal)
        terminal.until("next in")
        terminal.process.send_signal(number)
        assert terminal.wait() == code
        assert read_terminal_modes(terminal) == before
    assert "\x1b[?1049l" in terminal.seen
    assert "\x1b[36m" not in terminal.seen, "no colour"


def test_sigterm_lets_the_running_action_finish(one: Path) -> None:
    (one / "tasks" / "one.yaml").write_text(SLOW)
    with ForkedProcess(
        watch_command("--apply", "--every", "1h"), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        deadline = time.monotonic() + LIMIT_S
        while not any(entry["event"] == "phase" for entry in read_entries(one / "state")):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=LIMIT_S)
    assert (process.returncode, err) == (0, "watching one every 1h00m; plans are applied\n")
    assert "task-started idle on edge1" in out
    assert [entry["event"] for entry in read_entries(one / "state")][-2:] == ["end", "placed"]


def test_off_a_terminal_a_line_where_something_happened_and_nothing_else(one: Path, run: Run) -> None:
    said = run("watch", "--apply", "--every", "1s", "--cycles", "3")
    assert (said.code, said.err) == (0, "watching one every 1.0s; plans are applied\n")
    assert [line.split()[1] for line in said.out.splitlines()] == ["task-started"], said.out
    again = run("watch", "--every", "1s", "--cycles", "2")
    assert again == (0, "", "watching one every 1.0s; plans are not applied\n")
    assert run("stop", "--all", "--yes").code == 0
    planned = run("watch", "--every", "1s", "--cycles", "2")
    assert planned.code == 0
    assert planned.out.count("planned: 1 start") == 1


def test_files_that_change_are_read_anew_and_broken_ones_said(one: Path) -> None:
    with ForkedProcess(
        watch_command("-o", "jsonl", "--every", "1s", "--cycles", "60"), stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        rounds = (json.loads(line) for line in process.stdout)
        first = next(rounds)
        assert (first["cycle"], first["warnings"], [entry["task"] for entry in first["pending"]]) == (
            1,
            [],
            ["idle"],
        )
        (one / "tasks" / "one.yaml").write_text(TASKS.replace("demand", "demnd"))
        broken = next(each for each in rounds if each["warnings"])
        assert "one.yaml:3:" in broken["warnings"][0]
        assert [entry["task"] for entry in broken["pending"]] == ["idle"]
        (one / "tasks" / "one.yaml").write_text(TASKS.replace("idle:", "other:"))
        mended = next(
            each
            for each in rounds
            if not each["warnings"] and [entry["task"] for entry in each["pending"]] != ["idle"]
        )
        assert [entry["task"] for entry in mended["pending"]] == ["other"]
        process.send_signal(signal.SIGTERM)
        for _ in rounds:
            pass
        assert process.wait(LIMIT_S) == 0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--every", "0.2"), "--every 0.2 is too short"),
        (("-o", "yaml"), 'output format "yaml" is not supported here'),
        (("--without", "edge7"), "unknown host 'edge7'"),
        (("--cycles", "0"), "0"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_is_done(
    one: Path, run: Run, given: tuple[str, ...], said: str
) -> None:
    refused = run("watch", *given)
    assert (refused.code, refused.out) == (64, "")
    assert said in refused.err


def test_the_exit_code_is_that_of_the_last_cycle(one: Path, run: Run) -> None:
    (one / "inventories" / "one.yaml").write_text(
        INVENTORY + "  edge2: {host: 127.0.0.1, port: 1, connection: openssh}\n"
    )
    assert run("watch", "--every", "1s", "--cycles", "1").code == 4
