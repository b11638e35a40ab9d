# SPDX-License-Identifier: Apache-2.0
"""Unknown tasks on one host, each slow to stop, keep nobody else waiting."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.executor import stop_budget
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.plan import Action, Step
from edgectl.model.result import Outcome
from edgectl.state.journal import Journal
from tests.builders import a_task
from tests.executor.fake_fleet import FakeFleet
from tests.executor.test_run import a_plan, a_step, find_result, run_steps


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with Journal.open(tmp_path) as opened:
        yield opened


def a_ghost(number: int) -> Step:
    decision = Decision(
        task=f"ghost{number}", verdict=Verdict.UNPLACED, reason=Reason.LEFT_FILE, previous_host="edge1"
    )
    return Step(decision=decision, action=Action.STOP, instances={"edge1": "x"})


def test_24_ghosts_do_not_delay_a_start_elsewhere(journal: Journal) -> None:
    fleet = FakeFleet.of(["edge1", "edge2"])
    fleet["edge1"].delay = 0.05
    plan = a_plan(*(a_ghost(number) for number in range(24)), a_step("t0", Action.START, host="edge2"))
    results = run_steps(fleet, journal, plan, a_task("t0"), max_parallel=8)
    assert results.done
    stops = [at for at, event in enumerate(fleet.changes) if event.startswith("stop ghost")]
    assert fleet.changes.index("start t0 edge2") < stops[4], "two at a time of eight are stopped"
    assert len(stops) == 24


def test_a_start_waits_for_the_stops_on_its_own_host(journal: Journal) -> None:
    fleet = FakeFleet.of(["edge1", "edge2"])
    fleet["edge1"].delay = 0.05
    plan = a_plan(a_ghost(1), a_step("t0", Action.START, host="edge1"))
    assert run_steps(fleet, journal, plan, a_task("t0")).done
    assert fleet.changes == ["stop ghost1 edge1", "start t0 edge1"]


def test_what_a_host_may_take_of_a_run_is_bounded(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_budget.StopBudget.__init__, "__defaults__", (0.1, time.monotonic))
    fleet = FakeFleet.of(["edge1", "edge2"])
    fleet["edge1"].delay = 0.06
    results = run_steps(fleet, journal, a_plan(*(a_ghost(number) for number in range(12))), max_parallel=4)
    outcomes = [find_result(results, f"ghost{number}").outcome for number in range(12)]
    assert outcomes[0] is Outcome.DONE
    assert outcomes[-1] is Outcome.DEFERRED
    assert "have taken 0.1 s on edge1" in find_result(results, "ghost11").error
