# SPDX-License-Identifier: Apache-2.0
"""Standby copies of ROS 2 lifecycle nodes: configured, activated and deactivated by the helper of their host."""

import itertools
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.errors import RefusedError
from tests.agent.conftest import AgentHost, eventually
from tests.agent.switching import Ticker
from tests.ros.test_ros2 import PYTHON
from tests.views.fixtures import ROOT

NODE = Path(__file__).with_name("waiting_node.py")
NUMBERS = itertools.count()
pytestmark = pytest.mark.skipif(not PYTHON.exists(), reason="rclpy is not installed: make ros")


@pytest.fixture
def domain() -> str:
    """A domain of its own: another test's keeper would end the helper of both."""
    return str(1 + (os.getpid() + 100 * next(NUMBERS)) % 200)


class LifecycleTask(Ticker):
    """The task ``slam``: a node of the name ``node`` that waits for its transitions."""

    def __init__(self, host: AgentHost, folder: Path, domain: str, node: str = "slam") -> None:
        super().__init__(host, folder, activate=None, deactivate=None, ready=None, lifecycle=f"/{node}")
        (folder / "setup.bash").write_text(f"export PATH={PYTHON.parent}:$PATH\n")
        self.command = f"exec python3 {NODE} {node} {folder}/changes"
        self.ros = {"version": 2, "setup": [str(folder / "setup.bash")], "peers": [], "values": {}}
        self.env = {"ROS_DOMAIN_ID": domain, "PYTHONPATH": str(ROOT)}

    def spec(self, **spec: Any) -> dict[str, Any]:
        return super().spec(**{"ros": self.ros, "env": self.env, **spec})


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[AgentHost]:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    host = AgentHost("edge1", tmp_path / "state")
    yield host
    host.stop("slam")
    host.end()


def test_a_node_waits_configured_and_is_activated(lab: AgentHost, tmp_path: Path, domain: str) -> None:
    task = LifecycleTask(lab, tmp_path, domain)
    assert task.start(restart="always")["role"] == "standby"
    pid = int(lab.until("slam", "ready", seconds=60.0)["pid"])
    assert task.changes() == ["configured"]
    for op, word in (("activate", "active"), ("deactivate", "standby")) * 3:
        with task.hold(op) as held:
            assert task.changes()[-1] != word
            held.go()
            assert held.wait()["state"] == word
        # The reply is the proof: the node has made the transition by then.
        assert task.changes()[-1] == word
    task.switch("activate")
    os.kill(pid, signal.SIGKILL)
    eventually(
        lambda: (e := lab.entry("slam")) and (e["restarts"], e["state"]) == (1, "running"), seconds=60.0
    )
    assert (task.role(), task.changes()[-2:]) == (("active", False), ["configured", "active"])


def test_two_nodes_of_one_name_are_left_alone(lab: AgentHost, tmp_path: Path, domain: str) -> None:
    """A request to one would reach both: two would be active."""
    task = LifecycleTask(lab, tmp_path, domain)
    task.start()
    lab.until("slam", "ready", seconds=60.0)
    other_folder = tmp_path / "other"
    other_folder.mkdir()
    other = LifecycleTask(AgentHost("edge2", lab.state), other_folder, domain)
    # One helper for both: each discovers the nodes for itself.
    other.ros = task.ros
    other.start()
    try:
        eventually(
            lambda: "2 nodes are called /slam" in str((other.host.entry("slam") or {}).get("detail")),
            seconds=60.0,
        )
        assert other.changes() == []
        with pytest.raises(RefusedError, match="2 nodes are called /slam: write"):
            task.switch("activate")
        assert task.changes() == ["configured"]
    finally:
        other.host.stop("slam")
        other.host.end()
