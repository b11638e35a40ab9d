# SPDX-License-Identifier: Apache-2.0
"""``edgectl export ros`` on real graphs: a subscriber of Debian's ROS 1 and one of rclpy hear the fleet."""

import contextlib
import json
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from tests.cli.fleet_dir import enter_fleet
from tests.cli.inprocess import edgectl
from tests.e2e.test_unreachable import wait_until
from tests.forkserver import ForkedProcess
from tests.pace import patience
from tests.ros.test_ros2 import PYTHON

HEARING = Path(__file__).with_name("hearing.py")
OK, WARN, ERROR, STALE = range(4)
# Nothing listens at edge2.
INVENTORY = """
version: 1
fleet: lab
defaults:
  ros: {ros}
edges:
  edge1: {{host: 127.0.0.1, connection: local}}
  edge2: {{host: 127.0.0.1, port: {port}}}
"""
TASKS = """
version: 1
tasks:
  good: {hosts: {only: [edge1]}, demand: {cpu: 0, memory: 1Mi, throughput: 0}, command: exec sleep 1000}
  sick: {hosts: {only: [edge1]}, demand: {cpu: 0, memory: 1Mi, throughput: 0}, command: exec sleep 1000, alive: {command: "test ! -e $SICK", after: 1s}, env: {SICK: SICK_FILE}}
  broken: {hosts: {only: [edge1]}, demand: {cpu: 0, memory: 1Mi, throughput: 0}, command: exit 3, restart: never}
"""
# Beside the three tasks: two hosts, and the fleet.
LEVELS = {"fleet": ERROR, "host edge1": OK, "host edge2": ERROR}
LEVELS |= {"task good": OK, "task sick": WARN, "task broken": ERROR}


def find_free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@contextlib.contextmanager
def run_beside(*words: str, **variables: str) -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(words, env={**os.environ, **variables}, start_new_session=True)
    try:
        yield process
    finally:
        kill_with_children(process)


def kill_with_children(process: "subprocess.Popen[bytes]") -> None:
    """Kill it and its children, each of which roscore starts in a session of its own."""
    words = ["ps", "-o", "pid=", "--ppid", str(process.pid)]
    for line in subprocess.run(words, capture_output=True, text=True, check=False).stdout.split():
        with contextlib.suppress(OSError):
            os.kill(int(line), signal.SIGKILL)
    process.kill()
    process.wait()


@contextlib.contextmanager
def run_gateway(folder: Path, setup: Path) -> Iterator[ForkedProcess]:
    words = ["export", "ros", "--setup", str(setup), "--every", "1s"]
    process = ForkedProcess(words, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def read_heard(path: Path, topic: str) -> list[tuple[float, Any]]:
    lines = [json.loads(line) for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")]
    return [(at, content) for name, at, content in lines if name == topic]


def read_levels(content: dict[str, tuple[int, str]]) -> dict[str, int]:
    return {name.removeprefix("edgectl lab: "): level for name, (level, _) in content.items()}


def check_rhythm(path: Path, topic: str) -> None:
    """Wait for eight more messages: one a second."""
    before = len(read_heard(path, topic))
    wait_until(lambda: len(read_heard(path, topic)) >= before + 8, patience(30.0))
    times = [at for at, _ in read_heard(path, topic)[before:]]
    assert 0.9 < median(late - early for early, late in pairwise(times)) < 1.1


def check_gateway(folder: Path, heard: Path, setup: Path) -> None:
    """All that a subscriber of either ROS hears: rates, levels, the document, and what a frozen edgectl leaves."""
    applied = edgectl(["apply", "--yes"], folder, dict(os.environ))
    assert "Applied 2 of 3" in applied.out, applied
    (folder / "sick").touch()
    wait_until(heard.exists, patience(30.0))
    with run_gateway(folder, setup) as process:
        assert process.stderr is not None
        assert (
            process.stderr.readline() == "publishing /diagnostics and /edgectl/status; press Ctrl-C to stop\n"
        )
        wait_until(lambda: bool(read_heard(heard, "/diagnostics")), patience(30.0))
        wait_until(lambda: read_levels(read_heard(heard, "/diagnostics")[-1][1]) == LEVELS, patience(30.0))
        check_rhythm(heard, "/diagnostics")
        check_rhythm(heard, "/edgectl/status")
        told = json.loads(read_heard(heard, "/edgectl/status")[-1][1])
        shown = json.loads(edgectl(["status", "-o", "json"], folder, dict(os.environ)).out)
        assert {key: told[key] for key in ("format_version", "kind")} == {
            key: shown[key] for key in ("format_version", "kind")
        }
        assert [(item["task"], item["state"]) for item in told["items"]] == [
            (item["task"], item["state"]) for item in shown["items"]
        ]
        process.send_signal(signal.SIGSTOP)
        wait_until(
            lambda: set(read_levels(read_heard(heard, "/diagnostics")[-1][1]).values()) == {STALE},
            patience(40.0),
        )
        assert "measured nothing for" in read_heard(heard, "/diagnostics")[-1][1]["edgectl lab: task good"][1]
        assert read_heard(heard, "/edgectl/status")[-1][0] < read_heard(heard, "/diagnostics")[-1][0] - 0.5
        process.send_signal(signal.SIGCONT)
        wait_until(lambda: read_levels(read_heard(heard, "/diagnostics")[-1][1]) == LEVELS, patience(30.0))
        process.send_signal(signal.SIGINT)
        assert process.wait(patience(30.0)) == 0


@pytest.fixture
def port() -> int:
    return find_free_port()


def test_a_subscriber_of_ros_1_hears_the_fleet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, port: int
) -> None:
    setup, heard, master = tmp_path / "setup.bash", tmp_path / "heard", f"http://127.0.0.1:{find_free_port()}"
    setup.write_text("export PATH=/usr/bin:$PATH\n")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    inventory = INVENTORY.format(ros=f'{{version: 1, master: "{master}"}}', port=port)

    def list_nodes() -> list[str]:
        env = {**os.environ, "ROS_MASTER_URI": master}
        return subprocess.run(
            ["rosnode", "list"], env=env, capture_output=True, text=True, check=True
        ).stdout.split()

    with (
        enter_fleet(
            tmp_path, inventory, TASKS.replace("SICK_FILE", str(tmp_path / "sick")), monkeypatch
        ) as folder,
        run_beside("roscore", "-p", master.rpartition(":")[2]) as core,
    ):
        with run_beside("/usr/bin/python3", str(HEARING), "1", str(heard), ROS_MASTER_URI=master):
            check_gateway(folder, heard, setup)
            assert list_nodes() == ["/hearing", "/rosout"], "the gateway said goodbye"
        # Killed like by the kernel: the node ends with its input.
        with run_gateway(folder, setup) as process:
            assert process.stderr is not None
            assert process.stderr.readline()
            assert any(name.startswith("/edgectl_lab_") for name in list_nodes())
            process.kill()
            wait_until(lambda: not any(name.startswith("/edgectl") for name in list_nodes()), patience(20.0))
        with run_gateway(folder, setup) as process:
            assert process.stderr is not None
            assert process.stderr.readline()
            kill_with_children(core)
            with run_beside("roscore", "-p", master.rpartition(":")[2]):
                assert process.wait(patience(40.0)) == 75
                assert "was restarted: it does not know the gateway" in process.communicate()[1]


def test_a_subscriber_of_ros_2_hears_the_fleet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, port: int
) -> None:
    setup, heard, domain = tmp_path / "setup.bash", tmp_path / "heard", str(1 + os.getpid() % 200)
    setup.write_text(f"export PATH={PYTHON.parent}:$PATH\n")
    inventory = INVENTORY.format(ros=f"{{version: 2, domain: {domain}}}", port=port)
    with (
        enter_fleet(
            tmp_path, inventory, TASKS.replace("SICK_FILE", str(tmp_path / "sick")), monkeypatch
        ) as folder,
        run_beside(str(PYTHON), str(HEARING), "2", str(heard), ROS_DOMAIN_ID=domain),
    ):
        check_gateway(folder, heard, setup)
