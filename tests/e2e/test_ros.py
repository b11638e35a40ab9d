# SPDX-License-Identifier: Apache-2.0
"""A master of ROS 1 that restarts, and the tasks that need it. The master and the nodes are those of
`tests/ros1_peer.py`; ``make ros`` does the same with Debian's ROS.
"""

import os
import shlex
import signal
import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.model.assignment import Reason
from edgectl.model.check import AliveRule, Check
from edgectl.model.plan import Action
from edgectl.model.ros import RosCheck, RosSettings
from edgectl.model.snapshot import TaskState
from edgectl.model.task import HostRules, Need, NeedRestart, RestartPolicy, Task
from edgectl.views.reasons import describe_reason
from tests import ros1_peer
from tests.builders import a_task, an_edge, an_inventory
from tests.e2e.bench import GENTLE, Bench, a_local, open_bench
from tests.e2e.test_unreachable import wait_until

PEER = f"exec {shlex.quote(sys.executable)} -S {shlex.quote(ros1_peer.__file__)}"


@pytest.fixture
def port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@pytest.fixture
def bench(port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, isolated: Path) -> Iterator[Bench]:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    ros = RosSettings(version=1, master=f"http://127.0.0.1:{port}")
    hosts = [replace(a_local(an_edge(f"edge{n}"), "127.0.0.1"), ros=ros) for n in (1, 2)]
    with open_bench(an_inventory(*hosts), tmp_path / "manager", isolated) as made:
        yield made


def a_master_task(port: int) -> Task:
    command = f"{PEER} master {port}"
    ready = Check(command=f"python3 -c 'import socket; socket.create_connection((\"127.0.0.1\", {port}))'")
    return replace(
        a_task("roscore", command=command, stop=GENTLE),
        ready=ready,
        restart=RestartPolicy.ALWAYS,
        hosts=HostRules(pin="edge1"),
    )


def a_node_task(*needs: Need) -> Task:
    alive = Check(ros=RosCheck(node="/talker"))
    return replace(
        a_task("talker", command=f"{PEER} $ROS_MASTER_URI /talker", stop=GENTLE),
        ready=alive,
        alive=AliveRule(check=alive, after=0.1),
        hosts=HostRules(pin="edge2"),
        needs=needs,
    )


def test_dependants_restart_with_their_master(bench: Bench, port: int) -> None:
    """roscore dies and its supervisor starts it again: the node is lost, which its state says, and the next
    apply restarts it once the master is ready. One apply is enough.
    """
    bench = bench.using(a_master_task(port), a_node_task(Need(task="roscore", restart=NeedRestart.WITH)))
    bench.apply()
    assert bench.actions() == {"roscore": Action.KEEP, "talker": Action.KEEP}
    before = bench.sample("talker")
    assert (before.state, len(before.needed)) == (TaskState.READY, 6)
    os.kill(bench.sample("roscore").pid, signal.SIGKILL)
    wait_until(lambda: bench.sample("roscore").restarts == 1, 10.0)
    wait_until(lambda: bench.sample("talker").state is TaskState.UNHEALTHY, 10.0)
    step = bench.plan().steps[1]
    assert (step.task, step.action, step.decision.reason) == (
        "talker",
        Action.RESTART,
        Reason.NEED_RESTARTED,
    )
    assert describe_reason(step) == "restart: roscore restarted"
    bench.apply()
    after = bench.sample("talker")
    assert after.state is TaskState.READY
    assert after.instance != before.instance
    assert bench.actions() == {"roscore": Action.KEEP, "talker": Action.KEEP}
