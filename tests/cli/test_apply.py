# SPDX-License-Identifier: Apache-2.0
"""Commands that change a fleet, on one local edge with one small real process."""

import contextlib
import json
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.cli.fleet_dir import enter_fleet
from tests.cli.terminal import Terminal
from tests.forkserver import ForkedProcess
from tests.pace import patience

INVENTORY = """version: 1
edges:
  edge1: {host: 127.0.0.1, connection: local, capacity: {cpu: 1, memory: 1Gi}}
"""
TASKS = """version: 1
tasks:
  idle: {command: "echo started; exec sleep 600", demand: {cpu: 0.1, memory: 10Mi}, stop: {grace: 2s}}
"""


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """One edge, one task; whatever was started is stopped."""
    with enter_fleet(tmp_path, INVENTORY, TASKS, monkeypatch) as folder:
        yield folder


@pytest.mark.parametrize("words", [("apply",), ("stop", "--all"), ("restart", "idle"), ("apply", "--quiet")])
def test_nobody_to_ask_means_64_and_nothing_done(run: Run, small: Path, words: tuple[str, ...]) -> None:
    before = sorted((small / "state").rglob("*"))
    said = run(*words)
    assert (said.code, said.out) == (64, "")
    assert "hint: pass --yes" in said.err
    assert sorted((small / "state").rglob("*")) == before


def test_an_unknown_form_is_refused_before_anything_is_done(run: Run, small: Path) -> None:
    assert run("apply", "--yes", "-o", "markdown").code == 64
    assert run("apply", "--dry-run", "-o", "name").code == 64
    assert not (small / "state" / "agent-state").exists()


def test_apply_status_logs_restart_stop(run: Run, small: Path) -> None:
    said = run("apply", "--yes")
    assert said.code == 0
    assert "Plan: 1 to start" in said.out
    assert said.out.splitlines()[-1].startswith("Applied 1 of 1 in ")
    assert said.err.startswith("start idle: done")
    assert run("apply", "--yes", "--quiet") == (0, "", "")
    assert run("apply", "--yes").out.endswith("No changes. 1 task is where it should be.\n")
    assert json.loads(run("apply", "--yes", "-o", "json").out)["item"]["actions"] == []
    (before,) = json.loads(run("status", "-o", "json").out)["items"]
    assert (before["task"], before["host"], before["state"]) == ("idle", "edge1", "running")
    assert before["cpu"]["demand_cores"] == 0.1
    assert run("logs", "idle").out == "started\n"
    assert run("logs", "idle", "--since", "1h").out == "started\n"
    (again,) = json.loads(run("status", "-o", "json").out)["items"]
    assert (again["instance"], again["started_at"]) == (before["instance"], before["started_at"])
    restarted = json.loads(run("restart", "idle", "--yes", "-o", "json").out)["item"]
    assert restarted["actions"][0]["action"] == "restart"
    assert json.loads(run("status", "-o", "json").out)["items"][0]["pid"] != before["pid"]
    assert run("logs", "idle", "--previous").out == "started\n"

    assert run("stop", "idle", "--yes", "-o", "name").out == "task/idle\n"
    assert run("status", "-o", "name").out == ""


def test_what_a_task_prints_cannot_steer_the_terminal(run: Run, small: Path) -> None:
    (small / "tasks/lab.yaml").write_text(
        TASKS.replace("echo started", r"printf 'tab\\t\\033]0;title\\007\\033[31mred\\377\\n'")
    )
    assert run("apply", "--yes").code == 0
    assert run("logs", "idle").out == "tab\tred\ufffd\n"
    assert run("logs", "idle", "--raw").out == "tab\t\x1b]0;title\x07\x1b[31mred\ufffd\n"


def test_a_saved_plan_is_applied_once(run: Run, small: Path) -> None:
    run("plan", "--out", "next.plan")
    assert run("apply", "next.plan", "--target", "idle").code == 64
    assert run("apply", "next.plan").code == 0
    said = run("apply", "next.plan")
    assert said.code == 75
    assert (
        said.err
        == "error: saved plan is stale; since it was made:\n  it was applied before\nhint: make a new plan: edgectl plan --out PLAN\n"
    )


def test_a_plan_with_an_unknown_host_is_refused_also_in_a_dry_run(run: Run, small: Path) -> None:
    run("plan", "--out", "next.plan")
    plan = json.loads((small / "next.plan").read_text())
    plan["decisions"][0]["host"] = "edge9"
    (small / "next.plan").write_text(json.dumps(plan))
    for words in (("apply", "next.plan", "--dry-run"), ("apply", "next.plan")):
        said = run(*words)
        assert (said.code, said.out) == (75, "")
        assert "edge9 (start of idle) is not in the inventory" in said.err


def test_dry_run_prints_what_would_be_sent_and_sends_nothing(run: Run, small: Path) -> None:
    said = run("apply", "--dry-run")
    assert said.code == 0
    assert "# edge1: start idle\n" in said.out
    assert '"command": "echo started; exec sleep 600"' in said.out
    requests = json.loads(run("apply", "--dry-run", "-o", "json").out)["items"]
    assert [request["phase"] for request in requests] == ["reach", "start", "ready"]
    assert run("status", "-o", "name").out == ""


def test_done_reopen_cordon_uncordon(run: Run, small: Path) -> None:
    assert run("done", "idle").out == "task/idle marked as done\n"
    assert "No changes" in run("plan").out
    assert run("reopen", "idle").out == "task/idle reopened\n"
    assert run("cordon", "edge1").out == "edge/edge1 cordoned\n"
    said = run("plan", "--detailed-exitcode")
    assert (said.code, "0/1 hosts fit: 1 cordoned" in said.out) == (3, True)
    assert run("uncordon", "edge1").out == "edge/edge1 uncordoned\n"
    assert run("cordon", "edge9").code == 64
    assert run("done", "idel").code == 64


def test_a_second_edgectl_waits_or_ends_with_75(run: Run, small: Path) -> None:
    (small / "tasks" / "lab.yaml").write_text(TASKS.replace("stop:", f"{ready_check(small)}, stop:"))
    with start_edgectl("apply", "--yes") as first:
        wait_for_file(small, "state/agent-state/*/hosts/edge1/tasks/idle/log*", first)
        said = run("apply", "--yes")
        assert said.code == 75
        assert f"pid {first.pid}" in said.err
        (small / "go").touch()
        assert run("apply", "--yes", "--lock-timeout", "60s").code == 0
        first.communicate(timeout=patience(60))
    assert first.returncode == 0


def test_a_program_that_dies_at_start_is_never_done(small: Path, run: Run) -> None:
    """Also one that lives longer than a glance takes; what needs it is not started."""
    dying = 'command: "sleep 0.6; exit 3", up: 20s, restart: never'
    (small / "tasks" / "lab.yaml").write_text(
        TASKS.replace('command: "echo started; exec sleep 600"', dying)
        + "  next: {needs: [idle], command: sleep 600}\n"
    )
    said = run("apply", "--yes")
    assert said.code == 4
    assert "idle failed (exit code 3)" in said.out
    assert "needs idle, which did not start" in said.out


def ready_check(small: Path) -> str:
    """A ready check that passes once there is a file ``go``."""
    return f"ready: {{command: test -e {small}/go, timeout: 60s}}"


@contextlib.contextmanager
def start_edgectl(*words: str) -> Iterator["subprocess.Popen[str]"]:
    """Run one edgectl in the background and end it afterwards."""
    with ForkedProcess(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for_file(root: Path, pattern: str, process: "subprocess.Popen[str]") -> None:
    """Wait for a file that ``process`` creates."""
    end = time.monotonic() + patience(30)
    while not any(root.glob(pattern)):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, f"no {pattern}"
        time.sleep(0.1)


def test_bad_times_are_usage_errors(run: Run, small: Path) -> None:
    for words in (("apply", "--yes", "--lock-timeout", "soon"), ("probe", "--window", "-1")):
        said = run(*words)
        assert (said.code, "hint: write durations as 20s" in said.err) == (64, True)


def test_only_yes_is_a_yes(small: Path) -> None:
    for answer in ("no", "y", "YES", ""):
        with Terminal(["apply"], small) as terminal:
            terminal.until('Only "yes" is accepted: ')
            terminal.type(answer + "\n")
            assert terminal.wait() == 1
            assert "nothing was done" in terminal.seen
    with Terminal(["apply"], small) as terminal:
        terminal.until('Only "yes" is accepted: ')
        terminal.type("yes\n")
        assert terminal.wait() == 0
        named = [
            re.findall(text, terminal.seen)
            for text in (
                r"Apply this action to fleet (\S+)\? ",
                r"Applied 1 of 1 in \S+ Revision \d+ of fleet (\S+)\.",
                r"Fleet (lab-[0-9a-f]+)",
            )
        ]
        assert {each for found in named for each in found} == set(named[0]), terminal.seen
        assert all(named), "header, question and result name the fleet"


def test_ctrl_c_finishes_what_is_under_way(small: Path) -> None:
    (small / "tasks" / "lab.yaml").write_text(
        TASKS.replace("stop:", f"{ready_check(small)}, stop:")
        + "  next: {needs: [idle], command: sleep 600}\n"
    )
    with start_edgectl("apply", "--yes") as process:
        wait_for_file(small, "state/agent-state/*/hosts/edge1/tasks/idle/log*", process)
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        assert any("finishing the running actions" in line for line in process.stderr)
        (small / "go").touch()
        out, err = process.communicate(timeout=patience(60))
    assert process.returncode == 130
    assert "Interrupted." in out
    assert "Traceback" not in err


def test_a_second_ctrl_c_stops_at_once(small: Path) -> None:
    """While an action waits for a check that never holds; the next command finds what the first has begun."""
    check = 'ready: {command: "false", timeout: 10m}'
    (small / "tasks" / "lab.yaml").write_text(TASKS.replace("stop:", f"{check}, stop:"))
    with start_edgectl("apply", "--yes") as process:
        wait_for_file(small, "state/agent-state/*/hosts/edge1/tasks/idle/log*", process)
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        assert any("press Ctrl-C again to stop at once" in line for line in process.stderr)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=patience(60))
    assert process.returncode == 130
    assert "Traceback" not in err
