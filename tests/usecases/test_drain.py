# SPDX-License-Identifier: Apache-2.0
"""drain: tasks leave through their handoff contracts, or the remaining ones are reported."""

import dataclasses
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.errors import HostError, UsageError
from edgectl.model.check import Check, CheckLocation
from edgectl.model.plan import Action, Plan
from edgectl.model.policy import Policy
from edgectl.model.result import Outcome
from edgectl.model.standby_plan import StandbyAction
from edgectl.model.task import HandoffContract
from edgectl.state.manager_state import load_manager_state
from edgectl.usecases import operator_marks
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from edgectl.usecases.drain import DrainResult, drain_hosts
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.history import list_revisions
from edgectl.usecases.plan import make_plan
from tests.builders import NOW, a_robot, a_standby_rule, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet

POLICY = Policy(min_dwell=0.0)
SAFE = Check(command="safe", on=CheckLocation.ROBOT, timeout=1.0)
SLAM = a_task("slam", cpu=1.0, robots=["robot1"], handoff=HandoffContract(safe_when=SAFE, timeout=0.0))
NAV = a_task("nav", cpu=0.1, standby=a_standby_rule())
CAMERA = a_task("camera", cpu=1.0, pin="edge2")


class Bench:
    """slam on edge1, where it is placed first; camera stays on edge2."""

    def __init__(self, state: Path) -> None:
        self.hosts = FakeFleet.of(["edge1", "edge2", "robot1"])
        self.paused: list[float] = []
        self.fleet = Fleet(
            inventory=an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1")), tasks=some_tasks(SLAM, CAMERA),
            transport=self.hosts.transport, state=state, clock=lambda: NOW,
        )  # fmt: skip
        self.hosts["edge1"].runs("slam")
        self.hosts["edge2"].runs("camera")
        plan_and_apply(self.fleet, POLICY)

    def drain(self, *hosts: str, timeout: float = 20.0, **options: object) -> DrainResult:
        chosen = ApplyOptions(**options)  # type: ignore[arg-type]
        return drain_hosts(self.fleet, POLICY, hosts, options=chosen, timeout=timeout, pause=self.pause)

    def pause(self, seconds: float) -> None:
        self.paused.append(seconds)

    @property
    def marks(self) -> tuple[frozenset[str], frozenset[str]]:
        memory = load_manager_state(self.fleet.state)
        return memory.cordons, memory.draining


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_the_tasks_of_the_host_leave_and_it_stays_closed(bench: Bench) -> None:
    drained = bench.drain("edge1")
    assert drained.done
    assert {step.task: step.action for step in drained.applied.plan.steps} == {"slam": Action.MOVE}
    assert bench.hosts.placed == {"slam": "edge2", "camera": "edge2"}
    assert "check safe robot1" in bench.hosts.world.events
    assert bench.marks == (frozenset({"edge1"}), frozenset({"edge1"}))
    assert list_revisions(bench.fleet)[-1].verb == "drain"
    assert not make_plan(bench.fleet, POLICY).changes
    operator_marks.uncordon_hosts(bench.fleet, ["edge1"])
    assert bench.marks == (frozenset(), frozenset())


def test_inactive_copies_leave_the_host_too(bench: Bench) -> None:
    """nav runs on edge2 and waits on edge1: its copy ends, and nav itself is left alone."""
    fleet = replace(bench.fleet, tasks=some_tasks(SLAM, CAMERA, NAV))
    bench.hosts["edge2"].runs("nav")
    bench.hosts["edge1"].runs("nav", instance="copy", state="ready")
    bench.hosts["edge1"].tasks["nav"]["role"] = "standby"
    shown: list[Plan] = []

    def decline(plan: Plan) -> bool:
        shown.append(plan)
        return False

    assert drain_hosts(fleet, POLICY, ["edge1"], decline).applied.declined
    steps = {step.task: step for step in shown[0].steps}
    assert steps.keys() == {"slam", "nav"}
    assert steps["nav"].action is Action.KEEP
    assert [(each.host, each.action, each.instance) for each in steps["nav"].standbys] == [
        ("edge1", StandbyAction.STOP, "copy"),
        (None, StandbyAction.NONE, ""),
    ]


def test_a_declined_drain_closes_nothing(bench: Bench) -> None:
    assert drain_hosts(bench.fleet, POLICY, ["edge1"], lambda _plan: False).applied.declined
    assert bench.marks == (frozenset(), frozenset())
    with pytest.raises(UsageError, match="unknown host 'edge9'"):
        bench.drain("edge9")


def test_an_empty_host_is_closed_without_a_question(bench: Bench) -> None:
    bench.drain("edge1")
    again = drain_hosts(bench.fleet, POLICY, ["edge1"], lambda _plan: False)
    assert (again.done, again.applied.results) == (True, None)


def test_what_is_not_safe_yet_is_tried_again(bench: Bench) -> None:
    bench.hosts["robot1"].checks["safe"] = 1

    def calm(_seconds: float) -> None:
        bench.hosts["robot1"].checks["safe"] = 0

    drained = drain_hosts(bench.fleet, POLICY, ["edge1"], timeout=20.0, pause=calm)
    assert drained.done
    assert bench.hosts.placed["slam"] == "edge2"
    assert len(list_revisions(bench.fleet)) == 2
    outcomes = [
        [action.outcome for action in each.results.actions] for each in drained.passes if each.results
    ]
    assert outcomes == [[Outcome.DEFERRED], [Outcome.DONE]], "every pass is told"


def test_at_the_deadline_it_is_said_what_is_left(bench: Bench) -> None:
    bench.hosts["robot1"].checks["safe"] = 1
    drained = bench.drain("edge1", timeout=0.3)
    assert drained.left == (("slam", "edge1"),)
    assert bench.hosts.placed["slam"] == "edge1"
    assert bench.marks == (frozenset({"edge1"}), frozenset({"edge1"}))


def test_what_fits_nowhere_is_left_and_not_waited_for(bench: Bench) -> None:
    bench.hosts["edge2"].used = 4.0
    drained = bench.drain("edge1")
    assert (drained.left, bench.paused) == ((("slam", "edge1"),), [])


def test_a_host_that_does_not_answer_cannot_be_drained(bench: Bench) -> None:
    bench.hosts.down.add("edge1")
    assert bench.drain("edge1").left == (("slam", "edge1"),)


def test_fail_fast_does_not_try_again(bench: Bench) -> None:
    bench.hosts["edge2"].faults["start:slam"] = HostError("no space")
    drained = bench.drain("edge1", fail_fast=True)
    assert (drained.done, bench.paused) == (False, [])
    assert bench.hosts.placed["slam"] == "edge1"


def test_a_drain_that_is_asked_to_stop_begins_nothing_new(bench: Bench) -> None:
    options = ApplyOptions()

    def stop(_plan: object) -> bool:
        options.stop_requested.set()
        return True

    drained = drain_hosts(
        bench.fleet, POLICY, ["edge1"], stop, dataclasses.replace(options), timeout=5.0, pause=bench.pause
    )
    assert drained.applied.results is not None
    assert drained.applied.results.interrupted
    assert bench.hosts.placed["slam"] == "edge1"
