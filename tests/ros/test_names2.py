# SPDX-License-Identifier: Apache-2.0
"""One node name used twice in a graph of ROS 2, whose nodes nobody ends: rclpy and Fast DDS, on this machine."""

import os
import shlex
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.measure import proc
from tests.agent.conftest import AgentHost, eventually
from tests.ros.test_ros2 import NODE, PYTHON, a_question

SHORT = {"timeout_s": 10.0, "after_s": 1.0}


@pytest.fixture
def domain() -> str:
    """A domain of its own: other tests of this machine may run ROS 2 too."""
    return str(1 + (os.getpid() + 101) % 200)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[AgentHost]:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    host = AgentHost("edge1", tmp_path / "state")
    yield host
    host.stop("talker")
    host.end()


def start_talker(
    lab: AgentHost, tmp_path: Path, domain: str, command: str, restart: str = "never", **spec: Any
) -> None:
    setup = tmp_path / "setup.bash"
    setup.write_text(f"export PATH={PYTHON.parent}:$PATH\n")
    lab.start(
        "talker",
        command.format(node=f"python3 {shlex.quote(str(NODE))} talker"),
        ros={"version": 2, "setup": [str(setup)], "peers": [], "values": {}},
        env={"ROS_DOMAIN_ID": domain, "EDGECTL_HOST": "edge1"},
        ready={"command": "", "graph": a_question(node="/talker"), "timeout_s": 60.0},
        restart=restart,
        **spec,
    )


@contextmanager
def run_rival(domain: str) -> Iterator[int]:
    """A node of the same name that somebody starts by hand: its process."""
    env = {**os.environ, "ROS_DOMAIN_ID": domain}
    with subprocess.Popen([str(PYTHON), str(NODE), "talker"], env=env) as rival:
        try:
            yield rival.pid
        finally:
            rival.kill()


def test_a_node_name_that_is_used_twice_is_said_until_it_is_not(
    lab: AgentHost, tmp_path: Path, domain: str
) -> None:
    """Both nodes live, and both publish: ROS 2 throws none out. What is left of one that was killed does not count."""
    alive = {"command": "", "graph": a_question(node="/talker"), **SHORT}
    start_talker(lab, tmp_path, domain, "exec {node}", alive=alive)
    assert lab.until("talker", "ready", seconds=60.0)["detail"] == ""
    with run_rival(domain) as rival:
        said = lab.until("talker", "unhealthy", seconds=60.0)["detail"]
    assert said == (
        f"node /talker is also process {rival} of this host, and not of this task: its name is used twice"
    )
    # The graph has it for 20 s more.
    assert lab.until("talker", "ready", seconds=15.0)["detail"] == ""


def test_a_task_is_not_ready_by_the_node_of_another_or_of_its_own_past(
    lab: AgentHost, tmp_path: Path, domain: str
) -> None:
    hold = tmp_path / "hold"
    hold.touch()
    with run_rival(domain) as rival:
        wait = f"while [ -e {hold} ]; do sleep 0.1; done; exec {{node}}"
        start_talker(lab, tmp_path, domain, wait, restart="always")
        wait_for_detail(
            lab, f"node /talker is process {rival} of this host, and not of this task: its name is used twice"
        )
        hold.unlink()
        pid = lab.until("talker", "ready", seconds=60.0)["pid"]
    hold.touch()
    os.kill(pid, signal.SIGKILL)
    wait_for_detail(lab, "node /talker has ended, and the graph has not forgotten it yet")
    hold.unlink()
    lab.until("talker", "ready", seconds=60.0)


def wait_for_detail(lab: AgentHost, text: str) -> None:
    """Wait until the task is not ready for this reason."""

    def is_said() -> bool:
        entry = lab.entry("talker")
        return entry is not None and (entry["state"], entry["detail"]) == ("starting", text)

    eventually(is_said, seconds=30.0)


def test_two_nodes_of_one_name_in_a_task_are_said(lab: AgentHost, tmp_path: Path, domain: str) -> None:
    alive = {"command": "", "graph": a_question(node="/talker"), **SHORT}
    start_talker(lab, tmp_path, domain, "{node} & {node} & wait", alive=alive)
    said = lab.until("talker", "unhealthy", seconds=90.0)["detail"]
    nodes = sorted(pid for pid in lab.members("talker") if proc.read_cmdline(pid)[-1] == "talker")
    assert said == f"node /talker is processes {nodes[0]}, {nodes[1]} of this task: its name is used twice"
    os.kill(nodes[0], signal.SIGKILL)
    assert lab.until("talker", "ready", seconds=15.0)["detail"] == ""
