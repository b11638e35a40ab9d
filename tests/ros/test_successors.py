# SPDX-License-Identifier: Apache-2.0
"""Start-first moves of one node name on real ROS: only the new instance makes itself ready, and what its start does
to the old one is no fault of that.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from edgectl.model.check import AliveRule, Check, OnUnhealthy
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.ros import RosCheck, RosSettings, RosTopic
from edgectl.model.snapshot import TaskState
from edgectl.model.task import HandoffContract, HandoffOrder, HostRules, RestartPolicy, StopRule, Task
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from tests.builders import a_task, an_edge, an_inventory
from tests.e2e.bench import EAGER, QUICK, Bench, a_local, open_bench
from tests.e2e.test_unreachable import wait_until
from tests.pace import patience
from tests.ros.test_gateway import find_free_port, run_beside
from tests.ros.test_ros2 import PYTHON
from tests.ros.test_stops import list_names

HERE = Path(__file__).parent
# How long the command of a task takes until its node starts.
SLOW_S = 3.0


@dataclass(frozen=True)
class Lab:
    """Two edges on this machine in one graph. ``node``: a command of a talker on /counted, ``mute`` the same on another
    topic; ``service``: one that it offers.
    """

    version: int
    bench: Bench
    node: str
    mute: str
    service: str

    def a_talker(self, ready: RosCheck, host: str, command: str = "", timeout: float = 60.0) -> Task:
        rule = AliveRule(
            check=Check(ros=RosCheck(node="/talker")), after=0.5, on_unhealthy=OnUnhealthy.RESTART
        )
        return replace(
            a_task("talker", command=f"sleep {SLOW_S}; exec {command or self.node}"),
            stop=StopRule(signal="INT", grace=10.0),
            ready=Check(ros=ready, timeout=timeout),
            alive=rule if ready.node else None,
            restart=RestartPolicy.ALWAYS,
            hosts=HostRules(pin=host),
            handoff=HandoffContract(order=HandoffOrder.START_FIRST),
        )


@pytest.fixture(params=[1, 2])
def lab(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, isolated: Path
) -> Iterator[Lab]:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    with open_graph(request.param, tmp_path) as ros:
        hosts = [replace(a_local(an_edge(f"edge{n}"), "127.0.0.1"), ros=ros) for n in (1, 2)]
        with open_bench(an_inventory(*hosts), tmp_path / "manager", isolated) as bench:
            if ros.version == 1:
                node = f"/usr/bin/python3 {HERE / 'counting.py'} talk talker"
                yield Lab(1, bench, node, f"{node} /counted:=/other", "/talker/get_loggers")
            else:
                node = f"python3 {HERE / 'pipeline.py'} 2 talker source /counted 20 10"
                yield Lab(2, bench, node, node.replace("/counted", "/other"), "/talker/get_parameters")


@contextmanager
def open_graph(version: int, folder: Path) -> Iterator[RosSettings]:
    """A graph of its own: with ROS 1 it has a master, with ROS 2 a domain."""
    if version == 1:
        uri = f"http://127.0.0.1:{find_free_port()}"
        with run_beside("roscore", "-p", uri.rpartition(":")[2]):
            wait_until(lambda: list_names(uri) == {"/rosout"}, 60.0)
            yield RosSettings(version=1, master=uri)
        return
    setup = folder / "setup.bash"
    setup.write_text(f"export PATH={PYTHON.parent}:$PATH\n")
    yield RosSettings(version=2, domain=1 + (os.getpid() + 151) % 200, setup=(str(setup),))


def move(lab: Lab, task: Task) -> tuple[ActionResult, Bench]:
    """Apply; the result of the talker."""
    bench = lab.bench.using(task)
    applied = plan_and_apply(bench.fleet, EAGER, options=ApplyOptions(probe=QUICK))
    assert applied.results is not None
    return applied.results.actions[0], bench


@pytest.mark.parametrize("kind", ["node", "topic", "service"])
def test_the_old_instance_makes_no_new_one_ready(lab: Lab, kind: str) -> None:
    """The node of the new instance starts late, and what it will answer is answered by the old one meanwhile. Then
    the master of ROS 1 shuts that down, or both live under one name; neither is restarted for it.
    """
    ready = {
        "node": RosCheck(node="/talker"),
        "topic": RosCheck(topic=RosTopic(name="/counted")),
        "service": RosCheck(service=lab.service),
    }[kind]
    _, before = move(lab, lab.a_talker(ready, "edge1"))
    # The addresses of the nodes of ROS 1 are in the snapshot once the supervisor has looked.
    wait_until(lambda: lab.version == 2 or bool(before.sample("talker").nodes), 30.0)
    moved, bench = move(lab, lab.a_talker(ready, "edge2"))
    assert moved.outcome is Outcome.DONE, moved
    assert [phase.phase for phase in moved.phases] == [Phase.START, Phase.READY, Phase.STOP]
    assert moved.phases[1].seconds > SLOW_S - 1.0, "an answer of the old instance counted"
    assert bench.where() == {"talker": "edge2"}
    wait_until(lambda: bench.sample("talker").state is TaskState.READY, 30.0)
    assert bench.sample("talker").restarts == 0
    folder = Path(os.environ["EDGECTL_STATE_DIR"])
    logs = [path.read_text() for path in folder.rglob("log.*")]
    assert not any("restarting" in text for text in logs)


def test_an_old_instance_that_was_thrown_out_is_put_back(lab: Lab) -> None:
    """The new one never becomes ready: it talks on another topic."""
    ready = RosCheck(node="/talker", topic=RosTopic(name="/counted"))
    command = f"bash -c 'case $EDGECTL_HOST in edge2) exec {lab.mute};; esac; exec {lab.node}'"
    _, at_first = move(lab, lab.a_talker(ready, "edge1", command))
    before = at_first.sample("talker")
    failed, bench = move(lab, lab.a_talker(ready, "edge2", command, timeout=SLOW_S + patience(8.0)))
    assert (failed.outcome, failed.located) == (Outcome.FAILED, "edge1"), failed
    assert bench.where() == {"talker": "edge1"}
    wait_until(lambda: bench.sample("talker").state is TaskState.READY, 30.0)
    after = bench.sample("talker")
    assert after.restarts == 0
    if lab.version == 1:
        assert "; restored on edge1" in failed.error
        assert after.instance != before.instance
    else:
        assert "; it still runs on edge1" in failed.error
        assert after.pid == before.pid
