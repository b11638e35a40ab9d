# SPDX-License-Identifier: Apache-2.0
"""What an operator does by hand, on three real SSH servers: exec, ssh, move, unpin and start."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.terminal import Terminal
from tests.compiled_agent import give_agent_and_keys
from tests.forkserver import EDGECTL, ForkedProcess, run_edgectl
from tests.pace import patience
from tests.sshd import Lab, running_lab

HOSTS = ["edge3", "edge2", "edge1"]
INVENTORY = """
version: 1
fleet: by-hand
edges:
  edge3: {host: edge3, capacity: {cpu: 2, memory: 1Gi}, labels: {gpu: "yes"}}
  edge2: {host: edge2, capacity: {cpu: 2, memory: 1Gi}}
  edge1: {host: edge1, capacity: {cpu: 2, memory: 1Gi}}
"""
TASKS = """
version: 1
tasks:
  nav:
    command: "cd /tmp && sleep 1000 & wait"
    env: {ROS_MASTER_URI: "http://edge2:11311", ODD: "a 'b' $c"}
    hosts: {pin: edge2}
    stop: {grace: 1s}
    up: 50ms
    demand: {cpu: 0, memory: 0}
  slam: {command: "echo slam up; exec sleep 1000", stop: {grace: 1s}, up: 50ms, demand: {cpu: 0, memory: 0}}
  vision: {command: "printf 'vision up\\nhalf a line'; exec sleep 1000", hosts: {labels: {gpu: "yes"}}, stop: {grace: 1s}, up: 50ms, demand: {cpu: 0, memory: 0}}
"""


class Desk:
    """A directory with a fleet of three SSH hosts, in which edgectl is called."""

    def __init__(self, folder: Path, lab: Lab) -> None:
        self.folder, self.lab = folder, lab
        for name, text in (("inventories/lab.yaml", INVENTORY), ("tasks/lab.yaml", TASKS)):
            (folder / name).parent.mkdir()
            (folder / name).write_text(text)
        give_agent_and_keys(folder / "state", folder / "inventories" / "lab.yaml")
        self.env = {**os.environ, **lab.environment, "EDGECTL_STATE_DIR": str(folder / "state")}

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        return run_edgectl(*words, cwd=self.folder, env=self.env, timeout=patience(90))

    def call(self, *words: str) -> str:
        done = self.run(*words)
        assert done.returncode == 0, (words, done.stdout, done.stderr)
        return done.stdout

    def where(self, task: str) -> str:
        rows = [line.split() for line in self.call("get", "tasks").splitlines()]
        return next(row[1] for row in rows if row[0] == task)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    folder = tmp_path_factory.mktemp("by-hand")
    with running_lab(folder / "lab", HOSTS) as lab:
        made = Desk(folder, lab)
        made.call("apply", "--yes")
        yield made
        made.call("stop", "--all", "--yes")


def test_exec_has_the_environment_and_folder_of_the_task_and_its_exit_code(desk: Desk) -> None:
    """The values of the environment and the words of the command arrive as they are: no shell reads them."""
    assert (
        desk.call("exec", "nav", "--", "printenv", "ROS_MASTER_URI", "ODD")
        == "http://edge2:11311\na 'b' $c\n"
    )
    assert desk.call("exec", "task/nav", "--", "pwd") == f"{Path('/tmp').resolve()}\n"
    words = ["$HOME", "a b", "*", "'", '"', "`id`", "!x", "\\n", "--yes", "é"]
    said = desk.call("exec", "nav", "--", "python3", "-c", "import sys;print(sys.argv[1:])", *words)
    assert said == f"{words}\n"
    assert desk.run("exec", "nav", "--", "sh", "-c", "exit 7").returncode == 7
    missing = desk.run("exec", "nav", "--", "no-such-program")
    assert (missing.returncode, missing.stderr) == (127, "error: no-such-program: command not found\n")


def test_exec_reads_standard_input_and_is_no_part_of_the_task(desk: Desk) -> None:
    program = [sys.executable, "-c", EDGECTL, "exec", "nav", "--"]
    done = subprocess.run(
        [*program, "cat"],
        input="typed\n",
        cwd=desk.folder,
        env=desk.env,
        text=True,
        capture_output=True,
        check=True,
    )
    assert done.stdout == "typed\n"
    assert desk.run("exec", "nav", "--", "printenv", "EDGECTL_TASK_DIR").returncode == 1


def test_exec_with_a_terminal(desk: Desk) -> None:
    """-it gives the command a terminal of its own on the host, as kubectl does."""
    words = ["exec", "nav", "-it", "--", "sh", "-c", "tty; test -t 0 && echo terminal"]
    with Terminal(words, desk.folder, env={**desk.env, "TERM": "dumb"}) as terminal:
        assert terminal.wait() == 0
    assert "/dev/pts/" in terminal.seen
    assert "terminal" in terminal.seen


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["exec", "nab", "--", "true"], 64, "did you mean nav?"),
        (["exec", "nav", "-it", "--", "true"], 64, "stdin is not a terminal"),
        (["exec", "nav"], 64, "-- CMD"),
        (["ssh", "edge9"], 64, "did you mean edge"),
    ],
)
def test_wrong_calls_are_refused_before_anything_runs(
    desk: Desk, words: list[str], code: int, said: str
) -> None:
    done = desk.run(*words)
    assert done.returncode == code
    assert said in done.stderr


def test_ssh_logs_in_as_the_inventory_says_and_passes_the_exit_code_on(desk: Desk) -> None:
    for host in HOSTS:
        assert desk.call("ssh", host, "--", "echo", "$HOME") == f"{desk.lab[host].home}\n"
    assert desk.run("ssh", "edge3", "--", "exit", "9").returncode == 9
    line = shlex.split(desk.call("ssh", "edge3", "--dry-run"))
    assert line[0] == "ssh"
    assert "StrictHostKeyChecking=yes" in line


def test_ssh_refuses_a_host_whose_key_is_not_known(desk: Desk) -> None:
    known = desk.lab.known_hosts.read_text()
    desk.lab.known_hosts.write_text(
        "".join(line for line in known.splitlines(True) if desk.lab["edge3"].key not in line)
    )
    try:
        done = desk.run("ssh", "edge3", "--", "true")
        tried = desk.run("trust", "--all", "--dry-run")
        after = desk.lab.known_hosts.read_text()
    finally:
        desk.lab.known_hosts.write_text(known)
    assert done.returncode == 255
    assert "Host key verification failed" in done.stderr
    assert (tried.returncode, tried.stderr) == (4, "edge3: would be recorded (dry run)\n")
    assert desk.lab["edge3"].key not in after


def test_a_task_is_moved_by_hand_and_stays_until_it_is_unpinned(desk: Desk) -> None:
    here = desk.where("slam")
    there = next(host for host in HOSTS if host != here)
    said = desk.run("move", "task/slam", f"edge/{there}", "--for", "1h")
    assert said.returncode == 0
    assert said.stdout.startswith(f"task/slam pinned to {there} until ")
    assert said.stderr.startswith(f"next apply: move: pinned to {there} until ")
    assert desk.where("slam") == here
    assert f"slam is pinned to {there} until " in desk.run("status").stderr
    assert f"pinned to {there}" in desk.call("plan")
    differs = desk.run("diff")
    assert (differs.returncode, differs.stdout.splitlines()[3:]) == (
        1,
        [f"-slam on {here}", f"+slam on {there}"],
    )
    desk.call("apply", "--yes")
    assert desk.call("diff") == ""
    assert desk.where("slam") == there
    assert f"edgectl move pinned it to {there}" in desk.call("explain", "slam").replace("\n", " ")
    assert f"{there} until " in desk.call("describe", "task", "slam")
    assert desk.call("unpin", "slam") == "task/slam unpinned\n"
    assert "pinned" not in desk.run("status").stderr


def test_a_host_that_can_never_run_the_task_is_refused(desk: Desk) -> None:
    done = desk.run("move", "vision", "edge1")
    assert done.returncode == 64
    assert done.stderr.splitlines() == [
        "error: vision may not run on edge1, which lacks the labels gpu=yes",
        "hint: label it in the inventory: labels: {..}",
    ]


def test_start_undoes_stop_and_a_dry_run_does_nothing(desk: Desk) -> None:
    desk.call("stop", "vision", "--yes")
    assert '"op": "start"' in desk.call("start", "vision", "--dry-run")
    assert desk.where("vision") == "-"
    desk.call("start", "vision", "--yes")
    assert desk.where("vision") == "edge3"


def test_logs_of_several_tasks_say_whose_each_line_is(desk: Desk) -> None:
    """The log of nav is empty, which costs nothing; that of a task that nobody knows costs that task alone."""
    assert desk.call("logs", "slam") == "slam up\n"
    said = desk.call("logs", "-l", "kind=service,task!=nav", "-n", "1")
    assert said == "[task/slam] slam up\n[task/vision] half a line\n"
    assert desk.call("logs", "--prefix", "-n", "1", "vision") == "[task/vision] half a line\n"
    partly = desk.run("logs", "slam", "slan")
    assert (partly.returncode, partly.stdout) == (4, "[task/slam] slam up\n")
    assert partly.stderr == "task/slan: unknown task 'slan'\nhint: did you mean slam?\n"
    refused = desk.run("logs")
    hint = refused.stderr.splitlines()[-1]
    assert (refused.returncode, hint) == (64, "hint: list tasks: edgectl get tasks")


def test_status_again_and_again(desk: Desk) -> None:
    process = ForkedProcess(
        ["status", "-w", "--every", "200ms", "-o", "json"],
        cwd=desk.folder,
        env=desk.env,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    with process.stdout as lines:
        rows = [json.loads(lines.readline()) for _ in range(6)]
        process.send_signal(signal.SIGINT)
        assert process.wait(patience(60)) == 0
    assert [row["task"] for row in rows] == ["nav", "slam", "vision"] * 2


def test_a_dry_run_of_profilers_starts_none(desk: Desk) -> None:
    said = desk.run("profilers", "start", "edge/edge1", "edge3", "--dry-run")
    assert said.stderr.splitlines() == [
        f"{host}: profiler would start (dry run)" for host in ("edge1", "edge3")
    ]
    states = json.loads(desk.call("profilers", "status", "-o", "json"))["items"]
    assert {each["state"] for each in states} == {"not-running"}
    assert desk.run("profilers", "stop", "--dry-run").stderr == ""


def test_a_plan_is_printed_when_it_differs(desk: Desk) -> None:
    """Two plans: the present one, and the one in which slam has been pinned elsewhere."""
    here = desk.where("slam")
    there = next(host for host in HOSTS if host != here)
    process = ForkedProcess(
        ["plan", "-w", "--every", "200ms", "--target", "slam", "-o", "jsonl"],
        cwd=desk.folder, env=desk.env, stdout=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    try:
        with process.stdout as lines:
            first = [json.loads(lines.readline()) for _ in range(3)]
            desk.call("move", "slam", there)
            second = [json.loads(lines.readline()) for _ in range(3)]
            process.send_signal(signal.SIGINT)
            assert process.wait(patience(60)) == 0
    finally:
        desk.call("unpin", "slam")
    places = [{row["task"]: (row["action"], row["host"]) for row in rows}["slam"] for rows in (first, second)]
    assert places == [("keep", here), ("move", there)]
    assert desk.run("plan", "-w", "--out", "next.plan").returncode == 64


def test_what_is_sent_can_be_watched(desk: Desk) -> None:
    """Logins and requests with their durations on stderr, failures too, and never a command or an environment."""
    said = desk.run("-v", "get", "hosts", "--no-headers")
    lines = said.stderr.splitlines()
    for host in HOSTS:
        assert any(re.fullmatch(rf"{host}: login [0-9.]+s ok", line) for line in lines), lines
        assert any(re.fullmatch(rf"{host}: probe [0-9.]+s ok", line) for line in lines), lines
    desk.lab["edge2"].stop()
    try:
        failed = desk.run("restart", "slam", "--yes", "--log-format", "json", "-vv")
    finally:
        desk.lab["edge2"].restart()
    events = [json.loads(line) for line in failed.stderr.splitlines() if line.startswith("{")]
    assert {"host": "edge2", "operation": "login", "error": "connection refused"} in [
        {key: value for key, value in event.items() if key in ("host", "operation", "error")}
        for event in events
    ]
    assert any(event.get("operation") == "start" and event["task"] == "slam" for event in events)
    assert any("Authentication" in event.get("ssh", "") for event in events)
    assert "slam up" not in failed.stderr
    assert desk.run("get", "hosts").stderr == ""
