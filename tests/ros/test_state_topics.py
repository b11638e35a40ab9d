# SPDX-License-Identifier: Apache-2.0
"""The state of a task that is the last message of a latched topic: ROS 1 and ROS 2, between two hosts of this machine."""

import os
import shlex
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.model.check import Check
from edgectl.model.result import Outcome, Phase
from edgectl.model.ros import RosSettings
from edgectl.model.standby import StateRule
from edgectl.model.task import HostRules, Task
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from tests.builders import a_task, an_edge, an_inventory
from tests.e2e.bench import EAGER, QUICK, Bench, a_local, open_bench
from tests.e2e.test_unreachable import wait_until
from tests.pace import patience
from tests.ros import test_ros1
from tests.ros.test_ros2 import PYTHON

NODE = Path(__file__).with_name("map_node.py")
SIZE = 300_000


@contextmanager
def open_site(version: int, tmp_path: Path, isolated: Path) -> Iterator[tuple[Bench, list[Task]]]:
    """Two hosts with one graph, and what runs on them besides the mapper."""
    more: list[Task] = []
    if version == 1:
        with socket.create_server(("127.0.0.1", 0)) as server:
            master = f"http://127.0.0.1:{server.getsockname()[1]}"
        ros, more = RosSettings(version=1, master=master), [test_ros1.a_core(master)]
    else:
        setup = tmp_path / "setup.bash"
        setup.write_text(f"export PATH={PYTHON.parent}:$PATH ROS_DOMAIN_ID={1 + os.getpid() % 200}\n")
        ros = RosSettings(version=2, setup=(str(setup),))
    hosts = [replace(a_local(an_edge(f"edge{n}"), "127.0.0.1"), ros=ros) for n in (1, 2)]
    with open_bench(an_inventory(*hosts), tmp_path / "manager", isolated) as bench:
        yield bench, more


def a_mapper(version: int, folder: Path, host: str, topic: str = "/map") -> Task:
    python = "/usr/bin/python3" if version == 1 else "python3"
    words = shlex.join([python, str(NODE), str(version), str(folder / "seed"), str(folder)])
    return replace(
        a_task("mapper", command=f"exec {words}", up=0.5, stop=test_ros1.ROS_STOP),
        state=StateRule(topic=topic),
        hosts=HostRules(pin=host),
    )


@pytest.mark.parametrize("version", [1, 2])
def test_the_map_of_a_latched_topic_moves_along(
    version: int, tmp_path: Path, isolated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    text = os.urandom(SIZE // 2).hex()
    (tmp_path / "seed").write_text(text)
    with open_site(version, tmp_path, isolated) as (bench, more):
        bench.using(*more, a_mapper(version, tmp_path, "edge1")).apply()
        wait_until((tmp_path / "edge1").exists, patience(60.0))
        moved = bench.using(*more, a_mapper(version, tmp_path, "edge2")).apply().results
        assert moved is not None
        result = next(each for each in moved.actions if each.task == "mapper")
        assert result.outcome is Outcome.DONE, result
        assert [phase.phase for phase in result.phases] == [
            Phase.SAVE, Phase.TRANSFER, Phase.STOP, Phase.START, Phase.LOAD, Phase.READY,
        ]  # fmt: skip
        assert result.state is not None
        assert SIZE < result.state.size_bytes < SIZE + 1000
        wait_until((tmp_path / "edge2").exists, patience(10.0))
        assert (tmp_path / "edge2").read_text() == text
        spools = list((tmp_path / "hosts").rglob("tasks/*/state"))
        assert not spools
        print({phase.phase.value: round(phase.seconds, 2) for phase in result.phases})


@pytest.mark.parametrize("version", [1, 2])
def test_a_topic_without_a_publisher_fails_the_move_before_anything_stops(
    version: int, tmp_path: Path, isolated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    monkeypatch.setattr("edgectl.executor.state_requests._TOPIC", Check(timeout=6.0))
    with open_site(version, tmp_path, isolated) as (bench, more):
        bench.using(*more, a_mapper(version, tmp_path, "edge1", "/none")).apply()
        fleet = bench.using(*more, a_mapper(version, tmp_path, "edge2", "/none")).fleet
        results = plan_and_apply(fleet, EAGER, options=ApplyOptions(probe=QUICK)).results
        assert results is not None
        result = next(each for each in results.actions if each.task == "mapper")
        assert (result.outcome, result.located) == (Outcome.FAILED, "edge1")
        assert "no message on /none: it has no publisher" in result.error
        assert [phase.phase for phase in result.phases] == [Phase.SAVE]
