# SPDX-License-Identifier: Apache-2.0
"""A task that the plan saw alive is gone when it is to be stopped: another manager may have moved it."""

import dataclasses
from pathlib import Path

import pytest

from edgectl.errors import ConnectError
from edgectl.model.plan import Action, Plan
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.snapshot import TaskState
from edgectl.state.journal import Journal
from tests.builders import a_run, a_sample, a_snapshot, a_task
from tests.executor.fake_fleet import FakeFleet
from tests.executor.test_run import a_plan, a_step, run_steps

HOSTS = ("edge1", "edge2", "edge3")


def a_move(state: TaskState = TaskState.READY) -> Plan:
    """The plan of B: it saw t0 on edge1 and moves it to edge3."""
    seen = a_sample(tasks={"t0": a_run(state, instance="old", generation=1)})
    return a_plan(
        a_step("t0", Action.MOVE, host="edge3", previous="edge1"),
        snapshot=a_snapshot(edge1=seen, edge2=a_sample(), edge3=a_sample()),
    )


def carry_out(fleet: FakeFleet, state: Path, plan: Plan) -> ActionResult:
    with Journal.open(state) as journal:
        (result,) = run_steps(fleet, journal, plan, a_task("t0")).actions
    return result


def test_a_task_that_another_manager_moved_is_not_started_a_second_time(tmp_path: Path) -> None:
    fleet = FakeFleet.of(HOSTS)
    fleet["edge2"].runs("t0", instance="of-the-other-manager")
    result = carry_out(fleet, tmp_path, a_move())
    assert (result.outcome, result.located) == (Outcome.DEFERRED, "edge2")
    assert result.error == "t0 no longer runs on edge1 and runs on edge2: another manager moved it"
    assert fleet.placed == {"t0": "edge2"}


def test_a_host_that_does_not_answer_now_may_have_it(tmp_path: Path) -> None:
    fleet = FakeFleet.of(HOSTS)
    fleet["edge2"].faults["status"] = ConnectError("no route to host")
    result = carry_out(fleet, tmp_path, a_move())
    assert (result.outcome, result.located) == (Outcome.DEFERRED, "edge1")
    assert "edge2 does not answer: it may run there" in result.error
    assert fleet.placed == {}


@pytest.mark.parametrize(
    ("state", "generation", "words"),
    [
        ("completed", 1, "t0 completed on edge1 meanwhile"),
        ("failed", 9, "another manager started t0 on edge1"),
    ],
)
def test_a_task_that_ended_otherwise_than_the_plan_knew(
    tmp_path: Path, state: str, generation: int, words: str
) -> None:
    fleet = FakeFleet.of(HOSTS)
    fleet["edge1"].faults["stop"] = lambda _request: {"state": "not-running", "left": [], "seconds": 0.0}
    fleet["edge1"].tasks["t0"] = {"state": state, "pid": 0, "instance": "old", "generation": generation}
    result = carry_out(fleet, tmp_path, a_move())
    assert result.outcome is Outcome.DEFERRED
    assert words in result.error
    assert "t0" not in fleet["edge3"].tasks


def test_a_task_that_died_by_itself_is_moved(tmp_path: Path) -> None:
    fleet = FakeFleet.of(HOSTS)
    result = carry_out(fleet, tmp_path, a_move())
    assert (result.outcome, result.located) == (Outcome.DONE, "edge3")


def test_a_stop_of_what_runs_elsewhere_by_now_is_deferred(tmp_path: Path) -> None:
    fleet = FakeFleet.of(HOSTS)
    fleet["edge2"].runs("t0")
    plan = dataclasses.replace(a_move(), steps=(a_step("t0", Action.STOP, previous="edge1"),))
    result = carry_out(fleet, tmp_path, plan)
    assert (result.outcome, result.located) == (Outcome.DEFERRED, "edge2")
