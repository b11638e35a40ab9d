"""What an operator does by hand, on three real SSH servers: exec, ssh, move, unpin and start."""

import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.terminal import Terminal
from tests.compiled_agent import give_agent_and_keys
from tests.forkserver import EDGECTL, run_edgectl
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
  slam: {command: sleep 1000, stop: {grace: 1s}, up: 50ms, demand: {cpu: 0, memory: 0}}
  vision: {command: sleep 1000, hosts: {labels: {gpu: "yes"}}, stop: {grace: 1s}, up: 50ms, demand: {cpu: 0, memory: 0}}
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
    finally:
        desk.lab.known_hosts.write_text(known)
    assert done.returncode == 255
    assert "Host key verification failed" in done.stderr


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
    desk.call("apply", "--yes")
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
