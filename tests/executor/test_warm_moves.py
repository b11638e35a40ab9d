# SPDX-License-Identifier: Apache-2.0
"""Warm moves, activations and inactive copies, on simulated hosts."""

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest

from edgectl.errors import ConnectError, HostError, RefusedError
from edgectl.model.check import Check, CheckLocation
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.result import ActionResult, Outcome, Phase, Results
from edgectl.model.snapshot import HostSample, TaskState
from edgectl.model.standby import Activation, StandbyRule
from edgectl.model.standby_plan import StandbyAction, StandbyReason, StandbyStep
from edgectl.model.task import HandoffContract, Task
from edgectl.state.journal import Journal
from tests.builders import a_run, a_sample, a_snapshot, a_task
from tests.executor.fake_fleet import FakeFleet, Request
from tests.executor.test_run import a_plan, a_step, find_result, fleet, journal, run_steps
from tests.state.journal_files import read_entries

__all__ = ["fleet", "journal"]

_PAIR = Activation(
    activate=Check(command="wake"), deactivate=Check(command="sleep"), ready=Check(command="up")
)


def a_standby_task(name: str = "slam", **fields: Any) -> Task:
    return a_task(name, spec_hash=f"hash-{name}", standby=StandbyRule(activation=_PAIR), **fields)


def a_copy(
    action: StandbyAction, host: str, instance: str = "", reason: StandbyReason = StandbyReason.RUNNER_UP
) -> StandbyStep:
    return StandbyStep(host=host, action=action, reason=reason, instance=instance)


def a_host(*, task: str = "", copy: str = "", spec_hash: str = "hash-slam", **fields: Any) -> HostSample:
    """A host that has instance ``task`` of slam, or the inactive ``copy``."""
    run = a_run(TaskState.READY, instance=task or copy, spec_hash=spec_hash, **fields)
    sample = a_sample(tasks={"slam": run} if task else {})
    return dataclasses.replace(sample, standbys={"slam": run} if copy else {})


def plan_move(*, copy: bool, stays: bool = True, **fields: Any) -> Plan:
    """slam moves from edge1 to edge2, where a copy may wait."""
    standbys = (a_copy(StandbyAction.DEACTIVATE, "edge1", "old"),) if stays else ()
    hosts = {"edge1": a_host(task="old", **fields), "edge2": a_host(copy="copy") if copy else a_sample()}
    step = a_step("slam", Action.MOVE, host="edge2", previous="edge1", standbys=standbys)
    return a_plan(step, snapshot=a_snapshot(hosts))


def run_warm_move(
    fleet: FakeFleet, journal: Journal, *, copy: bool = True, stays: bool = True, **contract: object
) -> ActionResult:
    fleet["edge1"].runs("slam", role="active")
    if copy:
        fleet["edge2"].waits("slam")
    task = a_standby_task(robots=("robot1",), handoff=HandoffContract(**contract))  # type: ignore[arg-type]
    results = run_steps(fleet, journal, plan_move(copy=copy, stays=stays), task)
    assert "slam" not in fleet.world.overlap
    return find_result(results, "slam")


def list_active(fleet: FakeFleet) -> set[str]:
    return fleet.world.alive.get("slam", set())


HOOKS: dict[str, Any] = {
    "safe_when": Check(command="safe", on=CheckLocation.ROBOT),
    "hold": Check(command="hold", on=CheckLocation.ROBOT),
    "release": Check(command="release", on=CheckLocation.ROBOT),
}


def test_a_warm_move_goes_in_its_order_and_the_old_one_stays(fleet: FakeFleet, journal: Journal) -> None:
    ended = run_warm_move(fleet, journal, **HOOKS)
    assert ended.outcome is Outcome.DONE
    assert (ended.located, ended.instance) == ("edge2", "copy")
    assert ended.downtime_s is not None
    assert fleet.world.events == [
        "check safe robot1",
        "check hold robot1",
        "deactivate slam edge1",
        "activate slam edge2",
        "ready slam edge2",
        "check release robot1",
    ]
    assert [each.phase.value for each in ended.phases] == [
        *("safe", "hold", "deactivate", "activate", "ready", "release")
    ]


def test_without_a_copy_one_is_started_first_and_the_old_one_stops_last(
    fleet: FakeFleet, journal: Journal
) -> None:
    ended = run_warm_move(fleet, journal, copy=False, stays=False, **HOOKS)
    assert ended.outcome is Outcome.DONE
    assert fleet.world.events == [
        "copy slam edge2",
        "ready slam edge2",
        "check safe robot1",
        "check hold robot1",
        "deactivate slam edge1",
        "activate slam edge2",
        "ready slam edge2",
        "check release robot1",
        "stop slam edge1",
    ]
    assert fleet["edge2"].tasks["slam"]["role"] == "active"


def test_both_intents_are_in_the_journal_before_the_old_one_is_touched(
    fleet: FakeFleet, journal: Journal
) -> None:
    run_warm_move(fleet, journal)
    phases = [entry["phase"] for entry in read_entries(journal.path) if entry["event"] == "phase"]
    assert phases == ["activate", "deactivate"]


def refuse(_request: Request) -> Request:
    raise RefusedError("no")


def fail_to_activate(_request: Request) -> Request:
    return {"state": "activate-failed", "role": "standby", "switching": False, "detail": "exit code 1"}


def fail_halfway(_request: Request) -> Request:
    return {"state": "activate-failed", "role": "active", "switching": True, "detail": "timed out"}


def stay_active(_request: Request) -> Request:
    return {"state": "deactivate-failed", "role": "active", "active_again": True, "detail": "exit code 1"}


def hang_in_between(_request: Request) -> Request:
    return {"state": "deactivate-failed", "role": "active", "switching": True, "active_again": False}


Fault = HostError | Callable[[Request], Request]


@pytest.mark.parametrize(
    ("where", "op", "fault", "events"),
    [
        ("edge2", "activate", refuse, ["deactivate", "stop", "activate", "ready"]),
        ("edge2", "activate", fail_to_activate, ["deactivate", "activate", "ready"]),
        ("edge2", "activate", fail_halfway, ["deactivate", "stop", "activate", "ready"]),
        (
            "edge2",
            "wait",
            lambda _request: {"state": "failed"},
            ["deactivate", "activate", "stop", "activate", "ready"],
        ),
        ("edge1", "deactivate", refuse, []),
        ("edge1", "deactivate", stay_active, []),
        ("edge1", "deactivate", hang_in_between, ["activate", "ready"]),
        ("edge1", "deactivate", ConnectError("cut"), ["activate", "ready"]),
    ],
)
def test_failed_at_any_step_the_old_one_is_active_and_the_robot_released(
    fleet: FakeFleet, journal: Journal, where: str, op: str, fault: Fault, events: list[str]
) -> None:
    fleet[where].faults[op] = fault
    ended = run_warm_move(fleet, journal, **HOOKS)
    assert ended.outcome is Outcome.FAILED
    assert ended.located == "edge1"
    assert list_active(fleet) == {"edge1"}
    happened = [event.split()[0] for event in fleet.world.events if not event.startswith("check")]
    assert happened == events
    assert fleet.world.events[-1] == "check release robot1"


def test_the_old_one_stays_inactive_while_the_new_one_may_be_active(
    fleet: FakeFleet, journal: Journal
) -> None:
    fleet["edge2"].faults |= {"activate": ConnectError("cut"), "stop": ConnectError("cut")}
    ended = run_warm_move(fleet, journal, **HOOKS)
    assert (ended.outcome, ended.located) == (Outcome.FAILED, "edge2")
    assert "not activated again on edge1, because it may be active on edge2" in ended.error
    assert "STILL HOLDS" in ended.error
    assert not list_active(fleet)


def test_an_old_one_that_refuses_to_become_active_is_started_anew(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].faults["activate"] = fail_to_activate
    fleet["edge1"].faults["activate"] = refuse
    ended = run_warm_move(fleet, journal)
    assert (ended.outcome, ended.located) == (Outcome.FAILED, "edge1")
    assert fleet.world.events[-3:] == ["stop slam edge1", "start slam edge1", "ready slam edge1"]
    assert list_active(fleet) == {"edge1"}


def test_a_copy_that_does_not_get_ready_is_a_failure_and_touches_nothing(
    fleet: FakeFleet, journal: Journal
) -> None:
    fleet["edge2"].faults["wait"] = lambda _request: {"state": "failed", "exit_code": 1}
    ended = run_warm_move(fleet, journal, copy=False)
    assert (ended.outcome, ended.located) == (Outcome.FAILED, "edge1")
    assert list_active(fleet) == {"edge1"}


@pytest.mark.parametrize("fields", [{"spec_hash": "other"}, {"orphaned": True}])
def test_an_instance_that_may_not_know_how_moves_cold(
    fleet: FakeFleet, journal: Journal, fields: dict[str, Any]
) -> None:
    fleet["edge1"].runs("slam", role="active")
    fleet["edge2"].waits("slam")
    results = run_steps(fleet, journal, plan_move(copy=True, **fields), a_standby_task())
    assert find_result(results, "slam").outcome is Outcome.DONE
    assert fleet.world.events == ["stop slam edge1", "activate slam edge2", "ready slam edge2"]


def start_where_a_copy_waits(fleet: FakeFleet, journal: Journal, previous: str | None = None) -> ActionResult:
    fleet["edge2"].waits("slam")
    step = a_step("slam", Action.START, host="edge2", previous=previous)
    snapshot = a_snapshot({"edge2": a_host(copy="copy")})
    return find_result(run_steps(fleet, journal, a_plan(step, snapshot=snapshot), a_standby_task()), "slam")


@pytest.mark.parametrize("previous", [None, "edge1"])
def test_a_start_where_a_copy_waits_activates_it(
    fleet: FakeFleet, journal: Journal, previous: str | None
) -> None:
    ended = start_where_a_copy_waits(fleet, journal, previous)
    assert (ended.outcome, ended.located, ended.instance) == (Outcome.DONE, "edge2", "copy")
    assert fleet.world.events == ["activate slam edge2", "ready slam edge2"]


@pytest.mark.parametrize("fault", [refuse, fail_to_activate, fail_halfway])
def test_a_copy_that_cannot_be_activated_is_started_anew(
    fleet: FakeFleet, journal: Journal, fault: Fault
) -> None:
    fleet["edge2"].faults["activate"] = fault
    ended = start_where_a_copy_waits(fleet, journal, "edge1")
    assert (ended.outcome, ended.located) == (Outcome.DONE, "edge2")
    assert fleet.world.events == ["stop slam edge2", "start slam edge2", "ready slam edge2"]


def run_copies(fleet: FakeFleet, journal: Journal, *steps: Step, **hosts: HostSample) -> Results:
    return run_steps(
        fleet, journal, a_plan(*steps, snapshot=a_snapshot(hosts)), a_standby_task(), a_task("nav")
    )


def test_copies_stop_before_and_start_after_everything_else(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].runs("slam", role="active")
    fleet["edge2"].waits("slam")
    copies = (a_copy(StandbyAction.STOP, "edge2", "copy"), a_copy(StandbyAction.START, "edge3"))
    steps = (
        a_step("slam", Action.KEEP, host="edge1", standbys=copies),
        a_step("nav", Action.START, host="edge2"),
    )
    results = run_copies(fleet, journal, *steps, edge2=a_host(copy="copy"))
    assert results.done
    assert [(copy.host, copy.action, copy.outcome) for copy in results.standbys] == [
        ("edge2", StandbyAction.STOP, Outcome.DONE),
        ("edge3", StandbyAction.START, Outcome.DONE),
    ]
    assert [event for event in fleet.world.events if not event.startswith("ready")] == [
        *("stop slam edge2", "start nav edge2", "copy slam edge3")
    ]
    assert [entry["event"] for entry in read_entries(journal.path)].count("copied") == 2


def test_a_copy_of_another_spec_is_stopped_and_started_anew(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].waits("slam")
    step = a_step("slam", Action.KEEP, standbys=(a_copy(StandbyAction.RESTART, "edge2", "copy"),))
    assert run_copies(fleet, journal, step).done
    assert fleet.world.events == ["stop slam edge2", "copy slam edge2", "ready slam edge2"]


def test_no_copy_starts_where_its_task_failed(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].faults["start"] = refuse
    step = a_step("slam", Action.START, host="edge1", standbys=(a_copy(StandbyAction.START, "edge2"),))
    results = run_copies(fleet, journal, step)
    assert [copy.outcome for copy in results.standbys] == [Outcome.SKIPPED]
    assert not fleet.world.events


def test_a_copy_that_fails_is_reported_and_harms_nothing(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].faults["wait"] = lambda _request: {"state": "failed", "exit_code": 1}
    step = a_step("slam", Action.START, host="edge1", standbys=(a_copy(StandbyAction.START, "edge2"),))
    results = run_copies(fleet, journal, step)
    assert find_result(results, "slam").outcome is Outcome.DONE
    assert not results.done
    assert results.standbys[0].outcome is Outcome.FAILED
    assert "exit code 1" in results.standbys[0].error


def test_the_dead_end_of_a_phase_is_named(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].faults["activate"] = fail_to_activate
    ended = run_warm_move(fleet, journal)
    assert [(each.phase, each.ok) for each in ended.phases if not each.ok] == [(Phase.ACTIVATE, False)]
    assert ended.error == "slam was not activated on edge2: exit code 1; active again on edge1"
