# SPDX-License-Identifier: Apache-2.0
"""Questions to a graph of ROS 2: rclpy and Fast DDS from the package index, on this machine.

A helper answers them; it is there while tasks of the host live.
"""

import os
import shlex
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.measure import proc, system_files
from edgectl.agent.ros import graph2
from edgectl.agent.supervise import state_dir
from tests.agent.conftest import AgentHost, eventually
from tests.pace import patience
from tests.views.fixtures import ROOT

PYTHON = ROOT / ".venv-ros2" / "bin" / "python3"
NODE = Path(__file__).with_name("lifecycle_node.py")


@pytest.fixture
def setup(tmp_path: Path) -> Path:
    """A set-up file that makes the Python with rclpy the one of its shell."""
    found = tmp_path / "setup.bash"
    found.write_text(f"export PATH={PYTHON.parent}:$PATH ROS_SETUP_WAS_SOURCED=1\n")
    return found


@pytest.fixture
def domain() -> str:
    """A domain of its own: other tests of this machine may run ROS 2 too."""
    return str(1 + os.getpid() % 200)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[AgentHost]:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    host = AgentHost("edge1", tmp_path / "state")
    yield host
    host.stop("talker")
    host.end()


def a_question(**asked: Any) -> dict[str, Any]:
    return {"version": 2, "node": None, "topic": None, "service": None, "lifecycle": None, **asked}


def list_helpers(domain: str) -> list[int]:
    """Helpers of this test's user and domain on this machine; other tests have theirs."""
    mark, ours = f"edgectl-ros2-{os.geteuid()}-", f"ROS_DOMAIN_ID={domain}".encode()
    return [
        pid
        for pid in proc.read_process_table()
        if any(word.startswith(mark) for word in proc.read_cmdline(pid))
        and ours in system_files.read_file(f"/proc/{pid}/environ").split(b"\0")
    ]


def test_a_lifecycle_is_ready_once_active_and_its_death_is_seen(
    lab: AgentHost, setup: Path, domain: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ros = {"setup": [str(setup)], "peers": [], "values": {}}
    env = {"ROS_DOMAIN_ID": domain, "EDGECTL_HOST": "edge1"}
    everything = a_question(
        node="/talker",
        lifecycle="active",
        topic={"name": "/ticks", "within_s": 2.0},
        service="/talker/get_state",
    )
    before = set(list_helpers(domain))
    lab.start(
        "talker",
        f"exec python3 {shlex.quote(str(NODE))} talker",
        ros=ros,
        env=env,
        ready={"command": "", "graph": everything, "timeout_s": 60.0},
        alive={"command": "", "graph": a_question(node="/talker"), "timeout_s": 10.0, "after_s": 1.0},
    )
    assert lab.until("talker", "ready", seconds=60.0)["detail"] == ""

    def ask(**asked: Any) -> dict[str, Any]:
        return lab.ask(
            "check", command="", graph=a_question(**asked), prelude="", ros=ros, env=env, timeout_s=20.0
        )

    monkeypatch.setattr(state_dir, "_FLEET", [lab.fleet])
    seconds = []
    for _ in range(9):
        began = time.monotonic()
        asked = a_question(node="/talker", lifecycle="active")
        assert graph2.find_fault(asked, env, began + 10.0, [str(setup)]) == ("", "")
        seconds.append(time.monotonic() - began)
    print(f"median of an answer: {sorted(seconds)[4] * 1e3:.0f} ms")
    assert sorted(seconds)[4] < patience(0.3)
    assert ask(node="/talker", lifecycle="inactive")["output"] == "node /talker is active, not inactive"
    assert ask(node="/nobody")["output"] == "node /nobody is not in the graph"
    assert ask(service="/none")["exit"] == 1
    helpers = set(list_helpers(domain)) - before
    assert (
        len(
            [
                pid
                for pid in helpers
                if b"EDGECTL_TASK_DIR" not in system_files.read_file(f"/proc/{pid}/environ")
            ]
        )
        == 1
    )
    assert not helpers & lab.members("talker"), "it is no process of the task"
    # A helper that is gone says nothing of the task, and is there again.
    for pid in helpers:
        os.kill(pid, signal.SIGKILL)
    assert eventually(lambda: ask(node="/talker")["exit"] == 0, seconds=60.0)
    assert lab.entry("talker")["state"] == "ready"  # type: ignore[index]
    lab.stop("talker")
    eventually(lambda: not set(list_helpers(domain)) - before, seconds=60.0)
