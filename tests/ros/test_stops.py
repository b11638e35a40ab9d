# SPDX-License-Identifier: Apache-2.0
"""A stop leaves no process and no name: of nodes that ignore signals, fork, and are respawned under new names."""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.agent.measure import proc, system_files
from edgectl.agent.ros import registrations
from edgectl.model.check import Check
from edgectl.model.event import EventKind
from edgectl.model.ros import RosCheck, RosSettings
from edgectl.model.task import RestartPolicy, StopRule, Task
from edgectl.usecases.record import list_events_after
from tests.builders import a_task, an_edge, an_inventory
from tests.e2e.bench import Bench, a_local, open_bench
from tests.e2e.test_unreachable import wait_until
from tests.pace import patience
from tests.ros.test_gateway import find_free_port, run_beside
from tests.ros.test_ros2 import PYTHON

NODES = Path(__file__).with_name("lab_nodes")
OBSERVER = Path(__file__).with_name("graph_names.py")
# Long enough for a goodbye of those that say one.
IMPATIENT = StopRule(signal="INT", grace=1.0)
SHORT, WHOLE = 2, 50
# From the request to stop: the grace, the lease of Fast DDS (20 s), and what a busy machine takes.
LEASE_S = 30.0


@pytest.fixture
def master(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(NODES))
    uri = f"http://127.0.0.1:{find_free_port()}"
    with run_beside("roscore", "-p", uri.rpartition(":")[2]):
        wait_until(lambda: list_names(uri) == {"/rosout"}, patience(60.0))
        yield uri


@pytest.fixture
def bench(master: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, isolated: Path) -> Iterator[Bench]:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    hosts = [
        replace(a_local(an_edge(f"edge{n}"), "127.0.0.1"), ros=RosSettings(version=1, master=master))
        for n in (1, 2)
    ]
    with open_bench(an_inventory(*hosts), tmp_path / "manager", isolated) as made:
        yield made


def list_names(master: str) -> set[str]:
    """The nodes that a ROS 1 master knows; empty where it does not answer."""
    try:
        return registrations.Graph(master, time.monotonic() + 5.0).list_names()
    except registrations.CallError:
        return set()


def list_processes(folder: Path) -> list[int]:
    """The processes of tasks of the hosts below ``folder``."""
    mark = b"EDGECTL_TASK_DIR=" + os.fsencode(folder)
    return [
        pid
        for pid in proc.read_process_table()
        if any(
            entry.startswith(mark) for entry in system_files.read_file(f"/proc/{pid}/environ").split(b"\0")
        )
    ]


def a_launch(rule: StopRule = IMPATIENT) -> Task:
    command = f"exec roslaunch {NODES / 'stubborn.launch'}"
    return replace(a_task("lab", command=command, stop=rule), restart=RestartPolicy.NEVER)


@pytest.mark.timeout(3600)
def test_stops_of_a_launch_file_leave_no_process_and_no_name(
    bench: Bench, master: str, tmp_path: Path, whole: bool
) -> None:
    bench = bench.using(a_launch())
    seconds = []
    for number in range(WHOLE if whole else SHORT):
        bench.apply()
        # One deaf node, a pair of the fork, and one that dies and is respawned: rosout is the fifth.
        wait_until(lambda: len(list_names(master)) >= 5, patience(60.0))
        time.sleep(0.7 * (number % 4))
        began = time.monotonic()
        stopped = bench.stop("lab")
        seconds.append(time.monotonic() - began)
        assert stopped.results is not None
        assert stopped.results.done
        [phase] = stopped.results.actions[0].phases
        assert phase.detail.startswith("unregistered /deaf, "), phase
        assert list_names(master) == {"/rosout"}, phase
        assert list_processes(tmp_path / "hosts") == []
    print(f"{len(seconds)} stops, {min(seconds):.1f} to {max(seconds):.1f} s each")


def test_a_stop_where_the_master_is_gone_or_hangs_ends_in_time_and_says_so(
    bench: Bench, master: str, tmp_path: Path
) -> None:
    """A master that hangs costs the two looks; one that is gone has no registrations."""
    bench = bench.using(a_launch())
    bench.apply()
    wait_until(lambda: len(list_names(master)) >= 5, patience(60.0))
    [rosmaster] = [pid for pid in proc.read_process_table() if is_master(pid, master)]
    os.kill(rosmaster, signal.SIGSTOP)
    try:
        began = time.monotonic()
        stopped = bench.stop("lab")
        assert time.monotonic() - began < patience(20.0)
    finally:
        os.kill(rosmaster, signal.SIGCONT)
    assert stopped.results is not None
    assert stopped.results.done
    detail = stopped.results.actions[0].phases[0].detail
    assert f"(master {master}: no answer in time)" in detail
    assert list_processes(tmp_path / "hosts") == []
    [event] = [each for each in list_events_after(bench.fleet, 0) if each.kind is EventKind.TASK_STOPPED]
    assert detail in event.message
    # What could not be removed is removed with the names of the next instance.
    assert "/deaf" in list_names(master)
    bench.apply()
    bench.stop("lab")
    assert list_names(master) == {"/rosout"}
    bench.apply()
    wait_until(lambda: len(list_names(master)) >= 5, patience(60.0))
    os.kill(rosmaster, signal.SIGKILL)
    began = time.monotonic()
    stopped = bench.stop("lab")
    assert time.monotonic() - began < patience(15.0)
    assert stopped.results is not None
    assert stopped.results.actions[0].phases[0].detail == ""
    assert list_processes(tmp_path / "hosts") == []


def is_master(pid: int, master: str) -> bool:
    words = proc.read_cmdline(pid)
    return len(words) > 4 and words[1].endswith("rosmaster") and words[4] == master.rpartition(":")[2]


@pytest.fixture
def domain() -> int:
    """A domain of its own: other tests of this machine may run ROS 2 too."""
    return 1 + (os.getpid() + 57) % 200


@pytest.fixture
def bench2(domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, isolated: Path) -> Iterator[Bench]:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    setup = tmp_path / "setup.bash"
    setup.write_text(f"export PATH={PYTHON.parent}:$PATH\n")
    ros = RosSettings(version=2, domain=domain, setup=(str(setup),))
    with open_bench(
        an_inventory(replace(a_local(an_edge("edge1"), "127.0.0.1"), ros=ros)),
        tmp_path / "manager",
        isolated,
    ) as made:
        yield made


@pytest.mark.timeout(7200)
def test_stops_of_nodes_of_ros_2_leave_no_process_and_no_name(
    bench2: Bench, domain: int, tmp_path: Path, whole: bool
) -> None:
    """Nodes that were killed stay in the graph until their leases end; the stop waits for that."""
    node, names = f"python3 {NODES / 'stubborn.py'} 2", tmp_path / "names"
    command = f"{node} deaf & {node} forks & while :; do {node} dies; done"
    lab = replace(
        a_task("lab", command=command, stop=IMPATIENT),
        ready=Check(ros=RosCheck(node="/deaf"), timeout=60.0),
        restart=RestartPolicy.NEVER,
    )
    bench, seconds = bench2.using(lab), []
    with run_beside(str(PYTHON), str(OBSERVER), str(names), ROS_DOMAIN_ID=str(domain)):
        wait_until(names.exists, patience(60.0))
        for _ in range(WHOLE if whole else 1):
            bench.apply()
            wait_until(lambda: {"/deaf", "/forked", "/forks"} <= read_names(names), patience(60.0))
            began = time.monotonic()
            stopped = bench.stop("lab")
            seconds.append(time.monotonic() - began)
            assert stopped.results is not None
            [phase] = stopped.results.actions[0].phases
            assert phase.detail == ""
            assert list_processes(tmp_path / "hosts") == []
            # The observer may have heard the nodes some announcements later than the helper.
            left = began + LEASE_S - time.monotonic()
            wait_until(lambda: not {each for each in read_names(names) if "edgectl" not in each}, left)
    assert min(seconds) > 5.0, "the nodes were killed: their names outlive them"
    print(f"{len(seconds)} stops of ROS 2, {min(seconds):.1f} to {max(seconds):.1f} s each")


def read_names(path: Path) -> set[str]:
    return set(path.read_text().split())
