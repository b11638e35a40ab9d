# SPDX-License-Identifier: Apache-2.0
"""Unreachable hosts over real sshd: a task is replaced when its copy is certainly gone, and never kept twice."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.model.check import Check, CheckLocation
from edgectl.model.inventory import Inventory, Role
from edgectl.model.plan import Action, Step
from edgectl.model.result import Phase
from edgectl.model.snapshot import TaskState
from edgectl.model.task import HandoffContract, UnreachablePolicy
from edgectl.usecases import operator_marks
from edgectl.views.reasons import describe_reason
from tests.builders import an_inventory
from tests.e2e.bench import Bench, a_mark, a_sleeper, a_slice, list_sleepers, open_bench, wait_for_sleepers
from tests.pace import patience
from tests.sshd import Lab, Server

LINKS = {("edge1", "robot1"): 10e6, ("edge2", "robot1"): 10e6}


def build_inventory(lab: Lab) -> Inventory:
    edges = [a_slice(lab.host(name)) for name in ("edge1", "edge2")]
    return an_inventory(*edges, a_slice(lab.host("robot1", role=Role.ROBOT)), links=LINKS)


@pytest.fixture
def bench(lab: Lab, tmp_path: Path) -> Iterator[Bench]:
    with open_bench(build_inventory(lab), tmp_path / "manager", lab) as made:
        yield made


def plan_slam(bench: Bench) -> Step:
    return next(step for step in bench.plan().steps if step.task == "slam")


def cut_off(server: Server) -> None:
    """Cut the host off for everyone; what runs there goes on."""
    assert server.process is not None
    server.process.kill()
    server.process.wait()
    server.process = None


def restore_server(server: Server) -> None:
    server.start()
    server.wait()


def wait_until(condition: Callable[[], bool], within: float) -> None:
    deadline = time.monotonic() + patience(within)
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.3)


def build_recording_contract(robot: Path) -> HandoffContract:
    """Run a robot that records the requests of its hooks."""
    hold, release = (
        Check(command=f"echo {word} >> {robot}", on=CheckLocation.ROBOT) for word in ("hold", "release")
    )
    return HandoffContract(hold=hold, release=release)


def test_a_task_that_fences_itself_is_replaced_and_its_host_comes_back(
    lab: Lab, bench: Bench, tmp_path: Path
) -> None:
    mark, robot = a_mark(), tmp_path / "robot"
    fenced = a_sleeper(
        "slam", mark, on_unreachable=UnreachablePolicy.REPLACE, replace_after=1.0, self_fence=6.0
    )
    bench = bench.using(replace(fenced, robots=("robot1",), handoff=build_recording_contract(robot)))
    bench.apply()
    assert bench.where() == {"slam": "edge1"}
    first = wait_for_sleepers(mark)
    cut_off(lab["edge1"])
    assert plan_slam(bench).action is Action.HOLD
    wait_until(lambda: not list_sleepers(mark), within=40.0)
    assert plan_slam(bench).action is Action.HOLD, "gone, but the manager cannot know yet"
    wait_until(lambda: plan_slam(bench).action is Action.START, within=60.0)
    assert not robot.exists(), "so far nobody took the wheel"
    (replaced,) = applied.actions if (applied := bench.apply().results) else ()
    assert [phase.phase for phase in replaced.phases] == [Phase.HOLD, Phase.START, Phase.READY, Phase.RELEASE]
    assert robot.read_text() == "hold\nrelease\n"
    assert bench.where() == {"slam": "edge2"}
    assert len(wait_for_sleepers(mark)) == 2
    assert not set(first) & set(list_sleepers(mark))
    restore_server(lab["edge1"])
    assert not bench.plan().changes
    old = bench.probe().hosts["edge1"].tasks["slam"]
    assert (old.state, old.pid) == (TaskState.FAILED, 0)
    assert "fenced" in old.detail


def test_a_copy_that_outlived_the_operators_word_is_stopped_on_return(lab: Lab, bench: Bench) -> None:
    """The host was not off at all: until it is back two copies run; then the newer assignment wins, and plan
    reports it.
    """
    mark = a_mark()
    bench = bench.using(a_sleeper("slam", mark))
    bench.apply()
    old = wait_for_sleepers(mark)
    cut_off(lab["edge1"])
    assert plan_slam(bench).action is Action.HOLD
    operator_marks.fence_hosts(bench.fleet, ["edge1"])
    bench.apply()
    assert bench.where() == {"slam": "edge2"}
    new = sorted(set(wait_for_sleepers(mark, 4)) - set(old))
    restore_server(lab["edge1"])
    step = plan_slam(bench)
    assert (step.action, step.stop) == (Action.KEEP, ("edge1",))
    assert describe_reason(step).endswith("stop the one on edge1")
    assert "edge1 answers, so it is not powered off: its fence is cleared" in bench.said
    bench.apply()
    assert sorted(list_sleepers(mark)) == new
    assert bench.where() == {"slam": "edge2"}
    assert not bench.plan().changes


def test_a_host_that_is_asked_often_enough_keeps_its_task(bench: Bench) -> None:
    mark = a_mark()
    bench = bench.using(
        a_sleeper("slam", mark, on_unreachable=UnreachablePolicy.REPLACE, replace_after=1.0, self_fence=5.0)
    )
    bench.apply()
    before = wait_for_sleepers(mark)
    end = time.monotonic() + 7.0
    while time.monotonic() < end:
        time.sleep(0.5)
        bench.probe()
    assert list_sleepers(mark) == before
