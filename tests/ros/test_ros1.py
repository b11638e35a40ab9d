# SPDX-License-Identifier: Apache-2.0
"""What edgectl promises about a graph of ROS 1, on Debian's ROS: roscore, rospy and rostopic as they are."""

import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.agent.ros import graph1
from edgectl.model.check import AliveRule, Check, OnUnhealthy
from edgectl.model.plan import Action
from edgectl.model.ros import RosCheck, RosSettings, RosTopic
from edgectl.model.snapshot import TaskState
from edgectl.model.task import HostRules, Need, NeedRestart, RestartPolicy, StopRule, Task
from tests.builders import a_task, an_edge, an_inventory
from tests.e2e.bench import Bench, a_local, open_bench
from tests.e2e.test_unreachable import wait_until
from tests.pace import patience

ROS_STOP = StopRule(signal="INT", preset="ros", grace=10.0)
WITH_CORE = Need(task="roscore", restart=NeedRestart.WITH)
COUNTING = Path(__file__).with_name("counting.py")
NODE = f"exec /usr/bin/python3 {COUNTING}"


@pytest.fixture
def master() -> str:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"http://127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture
def bench(master: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, isolated: Path) -> Iterator[Bench]:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    ros = RosSettings(version=1, master=master)
    hosts = [replace(a_local(an_edge(f"edge{n}"), "127.0.0.1"), ros=ros) for n in (1, 2)]
    with open_bench(an_inventory(*hosts), tmp_path / "manager", isolated) as made:
        yield made


def a_core(master: str) -> Task:
    return replace(
        a_task("roscore", command=f"exec roscore -p {master.rpartition(':')[2]}", stop=ROS_STOP),
        ready=Check(ros=RosCheck(node="/rosout"), timeout=60.0),
        restart=RestartPolicy.ALWAYS,
        hosts=HostRules(pin="edge1"),
    )


def a_talker(policy: OnUnhealthy = OnUnhealthy.REPORT, *, restart: bool = True) -> Task:
    alive = Check(ros=RosCheck(node="/talker", topic=RosTopic(name="/counted")), timeout=60.0)
    return replace(
        a_task("talker", command=f"{NODE} talk talker", stop=ROS_STOP),
        ready=alive,
        alive=AliveRule(check=alive, after=1.0, on_unhealthy=policy),
        restart=RestartPolicy.ALWAYS,
        hosts=HostRules(pin="edge2"),
        needs=(WITH_CORE if restart else Need(task="roscore"),),
    )


def a_listener(path: Path) -> Task:
    return replace(
        a_task("listener", command=f"{NODE} hear listener {path}", stop=ROS_STOP),
        ready=Check(ros=RosCheck(node="/listener"), timeout=60.0),
        hosts=HostRules(pin="edge1"),
        needs=(WITH_CORE, Need(task="talker")),
    )


def read_count(path: Path) -> tuple[int, str]:
    """How many messages the listener has heard, and the process that sent the last one."""
    if not path.exists():
        return 0, ""
    count, _, pid = path.read_text().partition(" ")
    return int(count), pid


def wait_for_messages(path: Path) -> str:
    """The process that is heard: ten messages more than now."""
    wait_until(path.exists, patience(30.0))
    before, _ = read_count(path)
    wait_until(lambda: read_count(path)[0] >= before + 10, patience(30.0))
    return read_count(path)[1]


def kill_core(bench: Bench) -> None:
    """Kill the whole roscore as a power cut does; its supervisor starts it again."""
    pid = bench.sample("roscore").pid
    for line in subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False
    ).stdout.split():
        os.kill(int(line), signal.SIGKILL)
    os.kill(pid, signal.SIGKILL)
    wait_until(lambda: bench.sample("roscore").restarts == 1, 30.0)
    wait_until(lambda: bench.sample("roscore").state is TaskState.READY, 60.0)


def test_every_dependant_is_heard_again_after_roscore_was_killed(
    bench: Bench, master: str, tmp_path: Path
) -> None:
    """Within three cycles of probe and apply, by a listener that counts."""
    heard = tmp_path / "heard"
    bench = bench.using(a_core(master), a_talker(), a_listener(heard))
    bench.apply()
    before = wait_for_messages(heard)
    kill_core(bench)
    heard.unlink(missing_ok=True)
    cycles = 0
    while cycles == 0 or set(bench.actions().values()) != {Action.KEEP}:
        cycles += 1
        assert cycles <= 3
        bench.apply()
    after = wait_for_messages(heard)
    assert after != before
    assert subprocess.run(
        ["rosnode", "list"],
        env={**os.environ, "ROS_MASTER_URI": master},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split() == ["/listener", "/rosout", "/talker"]


def test_supervisors_restart_what_a_new_master_does_not_know(bench: Bench, master: str) -> None:
    """Without any manager: ``alive`` with ``on_unhealthy: restart``."""
    bench = bench.using(a_core(master), a_talker(OnUnhealthy.RESTART, restart=False))
    bench.apply()
    kill_core(bench)
    wait_until(lambda: bench.sample("talker").restarts >= 1, 60.0)
    wait_until(lambda: bench.sample("talker").state is TaskState.READY, 60.0)
    assert bench.actions() == {"roscore": Action.KEEP, "talker": Action.KEEP}


def test_answers_of_the_graph_are_true_and_cheap(bench: Bench, master: str) -> None:
    """Less than 100 ms of wall time each; a killed node is still registered, and is not alive."""
    bench = bench.using(a_core(master), replace(a_talker(), restart=RestartPolicy.NEVER))
    bench.apply()
    env, asked = {"ROS_MASTER_URI": master}, {"node": "/talker", "service": "/talker/get_loggers"}
    seconds, pid = [], str(bench.sample("talker").pid)
    for _ in range(9):
        began = time.monotonic()
        assert graph1.find_fault(asked, env, began + 10.0, []) == ("", pid)
        seconds.append(time.monotonic() - began)
    print(f"median of an answer: {sorted(seconds)[4] * 1e3:.1f} ms")
    assert sorted(seconds)[4] < patience(0.1)
    os.kill(bench.sample("talker").pid, signal.SIGKILL)
    fault, _ = graph1.find_fault({"node": "/talker"}, env, time.monotonic() + 10.0, [])
    assert fault.startswith("node /talker is registered at http://")
    assert "does not answer" in fault


def test_a_node_name_that_is_used_twice_is_said(bench: Bench, master: str) -> None:
    """Somebody starts a node of the same name by hand: the master shuts ours down, and the task is not alive
    by the answers of the other.
    """
    stays = replace(a_talker(), command=f"{NODE} talk talker & wait; sleep 600", restart=RestartPolicy.NEVER)
    bench = bench.using(a_core(master), stays)
    bench.apply()
    env = {**os.environ, "ROS_MASTER_URI": master, "ROS_IP": "127.0.0.1"}
    with subprocess.Popen(["/usr/bin/python3", str(COUNTING), "talk", "talker"], env=env) as thief:
        try:
            wait_until(lambda: bench.sample("talker").state is TaskState.UNHEALTHY, 60.0)
            detail = bench.sample("talker").detail
        finally:
            thief.kill()
    assert (
        detail
        == f"node /talker is process {thief.pid} of this host, and not of this task: its name is used twice"
    )


def test_respawn_on_both_sides_is_said(bench: Bench, master: str) -> None:
    """Two launchers start a node of one name again and again, and each start throws the other out: both live,
    and neither is any good.
    """
    again = f"while :; do /usr/bin/python3 {COUNTING} talk talker; done"
    respawns = replace(
        a_talker(), command=again, alive=AliveRule(check=Check(ros=RosCheck(node="/talker")), after=20.0)
    )
    bench = bench.using(a_core(master), respawns)
    bench.apply()
    env = {**os.environ, "ROS_MASTER_URI": master, "ROS_IP": "127.0.0.1"}
    with subprocess.Popen(["bash", "-c", again], env=env, start_new_session=True) as rival:
        try:
            wait_until(lambda: bench.sample("talker").state is TaskState.UNHEALTHY, 90.0)
            detail = bench.sample("talker").detail
        finally:
            os.killpg(rival.pid, signal.SIGKILL)
    assert "name" in detail
    assert "used twice" in detail
