# SPDX-License-Identifier: Apache-2.0
"""Order and dependencies of actions, and the effect of a failure."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.errors import ConnectError, DeadlineError, RefusedError
from edgectl.executor.run import RunIdentity, RunOptions, run_plan
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.check import Check, CheckLocation
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy
from edgectl.model.progress import ProgressEvent, ProgressStage
from edgectl.model.result import ActionResult, Outcome, Phase, Results
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import HandoffContract, HandoffOrder, Need, NeedCondition, Task
from edgectl.state.journal import Journal
from tests.builders import a_robot, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet, FakeHost
from tests.state.journal_files import read_entries

EDGES = ("edge1", "edge2", "edge3")


@pytest.fixture
def fleet() -> FakeFleet:
    return FakeFleet.of([*EDGES, "robot1"])


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with Journal.open(tmp_path) as opened:
        yield opened


def inventory() -> Inventory:
    return an_inventory(*(an_edge(name) for name in EDGES), a_robot("robot1"))


def a_step(
    task: str, action: Action, *, host: str | None = None, previous: str | None = None, **fields: object
) -> Step:
    verdict = {Action.COMPLETE: Verdict.COMPLETED, Action.KEEP: Verdict.KEPT, Action.HOLD: Verdict.HELD}.get(
        action, Verdict.PLACED
    )
    decision = Decision(task=task, verdict=verdict, reason=Reason.BEST, host=host, previous_host=previous)
    concerned = (
        {previous: "old"}
        if previous and action in (Action.MOVE, Action.STOP, Action.RESTART, Action.COMPLETE)
        else {}
    )
    return Step(decision=decision, action=action, instances=concerned, **fields)  # type: ignore[arg-type]


def a_plan(*steps: Step, snapshot: Snapshot | None = None) -> Plan:
    return Plan(
        created_at=0.0,
        policy=Policy(),
        inventory_digest="",
        tasks_digest="",
        snapshot=snapshot or a_snapshot(),
        settled=True,
        steps=steps,
        expected={},
    )


def run_steps(fleet: FakeFleet, journal: Journal, made: Plan, *tasks: Task, **options: object) -> Results:
    settings = RunOptions(poll_s=0.01, **options)  # type: ignore[arg-type]
    identity = RunIdentity(plan_id="p", revision=1)
    return run_plan(made, inventory(), some_tasks(*tasks), fleet.transport, journal, identity, settings)


def find_result(results: Results, task: str) -> ActionResult:
    return next(result for result in results.actions if result.task == task)


def test_a_start_follows_the_stops_on_its_host_and_its_needs(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].runs("old")
    fleet["edge2"].runs("finished")
    made = a_plan(
        a_step("navigation", Action.START, host="edge1"),
        a_step("slam", Action.START, host="edge2"),
        a_step("old", Action.STOP, previous="edge1"),
        a_step("finished", Action.COMPLETE, previous="edge2"),
    )
    ready = Check(command="is ready")
    results = run_steps(
        fleet,
        journal,
        made,
        a_task("slam", ready=ready),
        a_task("navigation", needs=["slam"], ready=ready),
        a_task("finished"),
    )
    assert results.done
    order = fleet.world.events
    assert order.index("stop finished edge2") < order.index("start slam edge2")
    assert order.index("stop old edge1") < order.index("start navigation edge1")
    assert (
        order.index("start slam edge2")
        < order.index("ready slam edge2")
        < order.index("start navigation edge1")
    )
    assert [result.task for result in results.actions] == ["navigation", "slam", "old", "finished"]
    assert find_result(results, "slam").located == "edge2"
    assert find_result(results, "old").located is None


def test_independent_actions_run_at_once(fleet: FakeFleet, journal: Journal) -> None:
    together = threading.Barrier(6)

    def met(request: dict[str, object]) -> dict[str, object]:
        together.wait(30)
        return {"state": "running"}

    for name in EDGES:
        fleet[name].faults["wait"] = met
    tasks = [a_task(f"task{number}") for number in range(6)]
    made = a_plan(
        *(a_step(task.name, Action.START, host=EDGES[number % 3]) for number, task in enumerate(tasks))
    )
    assert run_steps(fleet, journal, made, *tasks).done


def test_max_parallel_bounds_the_actions_at_once(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].delay = 0.1
    tasks = [a_task(f"task{number}") for number in range(3)]
    began = time.monotonic()
    run_steps(
        fleet,
        journal,
        a_plan(*(a_step(task.name, Action.START, host="edge1") for task in tasks)),
        *tasks,
        max_parallel=1,
    )
    assert time.monotonic() - began >= 0.3


def test_a_failed_start_skips_its_successors_and_nobody_else(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].faults["start:slam"] = RefusedError("disk is full")
    made = a_plan(
        a_step("slam", Action.START, host="edge1"),
        a_step("navigation", Action.START, host="edge2"),
        a_step("camera", Action.START, host="edge1"),
    )
    results = run_steps(
        fleet, journal, made, a_task("slam"), a_task("navigation", needs=["slam"]), a_task("camera")
    )
    assert (find_result(results, "slam").outcome, find_result(results, "slam").error) == (
        Outcome.FAILED,
        "disk is full",
    )
    assert find_result(results, "navigation").outcome is Outcome.SKIPPED
    assert find_result(results, "navigation").error == "needs slam, which did not start"
    assert find_result(results, "camera").outcome is Outcome.DONE
    assert not results.done


def test_a_start_whose_answer_was_lost_counts_as_there(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].faults["start"] = DeadlineError("no answer")
    results = run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge1")), a_task("slam"))
    assert (find_result(results, "slam").outcome, find_result(results, "slam").located) == (
        Outcome.FAILED,
        "edge1",
    )


def test_a_start_on_a_host_that_is_off_is_nowhere(fleet: FakeFleet, journal: Journal) -> None:
    fleet.down.add("edge1")
    results = run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge1")), a_task("slam"))
    assert (find_result(results, "slam").outcome, find_result(results, "slam").located) == (
        Outcome.FAILED,
        None,
    )
    assert find_result(results, "slam").error == "no route to host"


def test_a_task_that_is_not_ready_in_time_is_left_running(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].faults["wait"] = lambda _request: {"state": "running"}
    slow = a_task("slam", ready=Check(command="never", timeout=0.1))
    results = run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge1")), slow)
    assert find_result(results, "slam").error == "slam was not ready on edge1 within 0.1 s"
    assert find_result(results, "slam").hint == "edgectl logs slam"
    assert fleet.placed == {"slam": "edge1"}


def test_a_task_that_keeps_ending_says_how_it_ended(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].faults["wait"] = lambda _request: {
        "state": "starting",
        "detail": "exited with 7; restarting in 2.0 s",
    }
    slow = a_task("slam", ready=Check(command="never", timeout=0.1))
    results = run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge1")), slow)
    assert (
        find_result(results, "slam").error
        == "slam was not ready on edge1 within 0.1 s: exited with 7; restarting in 2.0 s"
    )


def test_a_task_that_dies_at_once_is_a_failure_with_its_exit_code(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].faults["wait"] = lambda _request: {"state": "failed", "exit_code": 127}
    results = run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge1")), a_task("slam"))
    assert find_result(results, "slam").error == "slam failed (exit code 127) on edge1"


def test_ready_on_the_robot_is_asked_there_and_marked_on_the_host(fleet: FakeFleet, journal: Journal) -> None:
    answers = iter([1, 1, 0])
    fleet["robot1"].faults["check"] = lambda _request: {
        "exit": next(answers),
        "timed_out": False,
        "output": "",
    }
    task = a_task(
        "slam", robots=["robot1"], ready=Check(command="sees the map", on=CheckLocation.ROBOT, timeout=5.0)
    )
    results = run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge1")), task)
    assert results.done
    assert "mark slam edge1" in fleet.world.events


def test_a_running_predecessor_is_waited_for(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].runs("slam", state="starting")
    slam = a_task("slam", ready=Check(command="is ready"))
    world = a_snapshot(edge1=a_sample(tasks={"slam": a_run(instance="old", state="starting")}))  # type: ignore[arg-type]
    made = a_plan(
        a_step("slam", Action.KEEP, host="edge1"),
        a_step("navigation", Action.START, host="edge2"),
        snapshot=world,
    )
    assert run_steps(fleet, journal, made, slam, a_task("navigation", needs=["slam"])).done
    assert fleet.world.events.index("ready slam edge1") < fleet.world.events.index("start navigation edge2")


def test_a_successor_of_an_unfinished_job_is_deferred(
    fleet: FakeFleet, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edgectl.executor.action_phases.COMPLETION_S", 0.1)
    made = a_plan(a_step("job", Action.START, host="edge1"), a_step("after", Action.START, host="edge1"))
    needs = Need(task="job", until=NeedCondition.COMPLETED)
    results = run_steps(fleet, journal, made, a_task("job"), a_task("after", needs=[needs]))
    assert (find_result(results, "after").outcome, find_result(results, "after").error) == (
        Outcome.DEFERRED,
        "waits for job to complete",
    )
    assert fleet.placed == {"job": "edge1"}


def test_a_successor_starts_once_its_job_has_completed(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].faults["status:job"] = lambda _request: {"tasks": {"job": {"state": "completed"}}}
    made = a_plan(a_step("job", Action.START, host="edge1"), a_step("after", Action.START, host="edge1"))
    assert run_steps(
        fleet,
        journal,
        made,
        a_task("job"),
        a_task("after", needs=[Need(task="job", until=NeedCondition.COMPLETED)]),
    ).done


def test_a_newcomer_waits_for_the_move_that_makes_room(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].runs("slam")
    made = a_plan(
        a_step("camera", Action.START, host="edge1"),
        a_step("slam", Action.MOVE, host="edge2", previous="edge1"),
    )
    assert run_steps(fleet, journal, made, a_task("camera"), a_task("slam")).done
    assert fleet.changes == ["stop slam edge1", "start slam edge2", "start camera edge1"]


def test_duplicates_are_stopped_and_the_kept_one_is_left_alone(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].runs("slam")
    fleet["edge2"].runs("slam")
    results = run_steps(
        fleet, journal, a_plan(a_step("slam", Action.KEEP, host="edge1", stop=("edge2",))), a_task("slam")
    )
    assert results.done
    assert fleet.placed == {"slam": "edge1"}
    assert find_result(results, "slam").located == "edge1"


def test_a_duplicate_that_stays_keeps_its_task_from_starting(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].runs("slam")
    fleet["edge2"].faults["stop"] = lambda _request: {"state": "stop-incomplete", "left": [77]}
    results = run_steps(
        fleet, journal, a_plan(a_step("slam", Action.START, host="edge1", stop=("edge2",))), a_task("slam")
    )
    assert find_result(results, "slam").error == "slam did not stop completely on edge2: processes left [77]"
    assert fleet.changes == []


def test_an_interrupted_run_finishes_what_it_began(
    fleet: FakeFleet, journal: Journal, tmp_path: Path
) -> None:
    stop = threading.Event()
    fleet["edge1"].faults["wait:slam"] = lambda _request: stop.set() or {"state": "running"}  # type: ignore[func-returns-value]
    made = a_plan(
        a_step("slam", Action.START, host="edge1"), a_step("navigation", Action.START, host="edge2")
    )
    results = run_steps(
        fleet, journal, made, a_task("slam"), a_task("navigation", needs=["slam"]), stop_requested=stop
    )
    assert results.interrupted
    assert find_result(results, "slam").outcome is Outcome.DONE
    assert find_result(results, "navigation").outcome is Outcome.SKIPPED
    log = read_entries(tmp_path / "journal.jsonl")
    events = [str(entry["event"]) for entry in log if entry["event"] != "phase"]
    assert (events[:2], events[-1]) == (["begin", "intent"], "end")
    assert sorted(events[2:-1]) == ["commit", "skipped"]
    assert log[-1]["interrupted"] is True


def test_every_side_effect_is_in_the_journal_before_it_happens(
    fleet: FakeFleet, journal: Journal, tmp_path: Path
) -> None:
    seen: list[list[str]] = []

    def start(request: dict[str, object]) -> dict[str, object]:
        seen.append([str(entry["event"]) for entry in read_entries(tmp_path / "journal.jsonl")])
        return fleet["edge1"]._start(request)

    fleet["edge1"].faults["start"] = start
    run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge1")), a_task("slam"))
    assert seen == [["begin", "intent", "phase"]]


def test_progress_is_told_in_the_callers_thread(fleet: FakeFleet, journal: Journal) -> None:
    heard: list[tuple[ProgressEvent, int]] = []
    made = a_plan(a_step("slam", Action.START, host="edge1"))
    run_plan(
        made,
        inventory(),
        some_tasks(a_task("slam")),
        fleet.transport,
        journal,
        RunIdentity(plan_id="p", revision=1),
        RunOptions(),
        lambda event: heard.append((event, threading.get_ident())),
    )
    assert [event.stage for event, _ in heard] == [
        ProgressStage.ACTION_BEGIN,
        ProgressStage.PHASE_BEGIN,
        ProgressStage.PHASE_END,
        ProgressStage.PHASE_BEGIN,
        ProgressStage.PHASE_END,
        ProgressStage.ACTION_END,
    ]
    assert {thread for _, thread in heard} == {threading.get_ident()}


def test_a_repeated_start_is_the_same_start(fleet: FakeFleet, journal: Journal) -> None:
    """The first reply is lost; the request is sent again with the same instance, so the host starts nothing
    twice.
    """
    lost = [True]

    def start(request: dict[str, object]) -> dict[str, object]:
        reply = fleet["edge1"]._start(request)
        if lost.pop() if lost else False:
            raise ConnectError("connection lost")
        return reply

    fleet["edge1"].faults["start"] = start
    assert run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge1")), a_task("slam")).done
    assert fleet.changes == ["start slam edge1"]


def a_contract(order: HandoffOrder = HandoffOrder.STOP_FIRST, **fields: object) -> HandoffContract:
    hooks: dict[str, Any] = {
        name: Check(command=name, on=CheckLocation.ROBOT) for name in ("safe_when", "hold", "release")
    }
    return HandoffContract(order=order, timeout=0.1, **{**hooks, **fields})


def run_move(fleet: FakeFleet, journal: Journal, contract: HandoffContract, **fields: object) -> ActionResult:
    fleet["edge1"].runs("slam")
    task = a_task("slam", robots=["robot1"], handoff=contract, **fields)  # type: ignore[arg-type]
    return find_result(
        run_steps(fleet, journal, a_plan(a_step("slam", Action.MOVE, host="edge2", previous="edge1")), task),
        "slam",
    )


def test_stop_first_goes_in_its_order_and_never_doubles(fleet: FakeFleet, journal: Journal) -> None:
    result = run_move(fleet, journal, a_contract())
    assert result.outcome is Outcome.DONE
    assert [phase.phase for phase in result.phases] == [
        Phase.SAFE,
        Phase.HOLD,
        Phase.STOP,
        Phase.START,
        Phase.READY,
        Phase.RELEASE,
    ]
    assert not fleet.world.overlap
    assert result.downtime_s is not None
    assert 0 < result.downtime_s < 5


def run_replacement(
    fleet: FakeFleet, journal: Journal, contract: HandoffContract, **fields: object
) -> ActionResult:
    """edge1 is unreachable and its copy of slam certainly stopped; edge2 gets a new one."""
    fleet.down.add("edge1")
    task = a_task("slam", robots=["robot1"], handoff=contract, **fields)  # type: ignore[arg-type]
    return find_result(
        run_steps(fleet, journal, a_plan(a_step("slam", Action.START, host="edge2", previous="edge1")), task),
        "slam",
    )


@pytest.mark.parametrize("order", list(HandoffOrder))
def test_a_replacement_holds_and_releases_and_asks_nothing_of_the_old_host(
    fleet: FakeFleet, journal: Journal, order: HandoffOrder
) -> None:
    result = run_replacement(fleet, journal, a_contract(order))
    assert (result.outcome, result.located, result.downtime_s) == (Outcome.DONE, "edge2", None)
    assert [phase.phase for phase in result.phases] == [Phase.HOLD, Phase.START, Phase.READY, Phase.RELEASE]
    events = ["check hold robot1", "start slam edge2", "ready slam edge2", "check release robot1"]
    assert [event for event in fleet.world.events if not event.startswith("status")] == events


def test_a_replacement_that_cannot_hold_is_deferred_and_stays_one(fleet: FakeFleet, journal: Journal) -> None:
    fleet["robot1"].checks["hold"] = 1
    result = run_replacement(fleet, journal, a_contract())
    assert (result.outcome, result.located, fleet.changes) == (Outcome.DEFERRED, "edge1", [])


def test_a_hold_on_the_silent_host_is_left_out(fleet: FakeFleet, journal: Journal) -> None:
    hooks: dict[str, Any] = {name: Check(command=name, on=CheckLocation.HOST) for name in ("hold", "release")}
    result = run_replacement(fleet, journal, a_contract(**hooks))
    assert (result.outcome, [phase.phase for phase in result.phases]) == (
        Outcome.DONE,
        [Phase.START, Phase.READY, Phase.RELEASE],
    )
    assert "check release edge2" in fleet.world.events


def test_a_replacement_that_is_not_ready_goes_on_holding(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].faults["wait"] = lambda _request: {"state": "failed", "exit_code": 3}
    result = run_replacement(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge2")
    assert (
        result.error == "slam failed (exit code 3) on edge2; robot1 STILL HOLDS: no instance of slam is ready"
    )
    assert "check release robot1" not in fleet.world.events


def test_a_replacement_that_the_new_host_refuses_is_tried_again(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].faults["start"] = RefusedError("disk is full")
    result = run_replacement(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge1")


def test_start_first_overlaps_and_its_downtime_is_nothing(fleet: FakeFleet, journal: Journal) -> None:
    result = run_move(
        fleet, journal, a_contract(HandoffOrder.START_FIRST, safe_when=None, hold=None, release=None)
    )
    assert result.outcome is Outcome.DONE
    assert fleet.changes == ["start slam edge2", "stop slam edge1"]
    assert result.downtime_s == 0.0


def test_a_move_that_is_not_safe_is_deferred_and_touches_nothing(fleet: FakeFleet, journal: Journal) -> None:
    fleet["robot1"].checks["safe_when"] = 1
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.DEFERRED, "edge1")
    assert result.error == "not safe to move slam within 0.1 s"
    assert fleet.changes == []


def test_a_move_to_a_host_that_is_off_is_deferred_and_touches_nothing(
    fleet: FakeFleet, journal: Journal
) -> None:
    fleet.down.add("edge2")
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located, result.error) == (Outcome.DEFERRED, "edge1", "no route to host")
    assert fleet.world.events == []


def test_a_new_instance_that_does_not_get_ready_is_replaced_by_the_old_one(
    fleet: FakeFleet, journal: Journal
) -> None:
    fleet["edge2"].faults["wait"] = lambda _request: {"state": "failed", "exit_code": 3}
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge1")
    assert result.error == "slam failed (exit code 3) on edge2; restored on edge1"
    assert fleet.placed == {"slam": "edge1"}
    assert fleet.changes == ["stop slam edge1", "start slam edge2", "stop slam edge2", "start slam edge1"]
    assert [phase.phase for phase in result.phases][-2:] == [Phase.READY, Phase.RELEASE]
    assert not fleet.world.overlap


def test_nothing_is_restored_while_the_new_instance_may_run(fleet: FakeFleet, journal: Journal) -> None:
    """edge2 becomes unreachable after the start was sent: two instances would be worse than none."""

    def start(_request: dict[str, object]) -> dict[str, object]:
        fleet.down.add("edge2")
        raise ConnectError("connection lost")

    fleet["edge2"].faults["start"] = start
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge2")
    assert "not restored on edge1, because it may still run on edge2" in result.error
    assert fleet.placed == {}


def test_a_failed_restoration_is_loud(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].faults["wait"] = lambda _request: {"state": "failed", "exit_code": 3}
    fleet["edge1"].faults["start"] = RefusedError("disk is full")
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, None)
    assert result.error == (
        "slam failed (exit code 3) on edge2; could not be restored on edge1 either: disk is full; "
        "robot1 STILL HOLDS: no instance of slam is ready"
    )
    assert result.hint == "apply again, which releases it once an instance is ready"
    assert "check release robot1" not in fleet.world.events


def test_a_restored_instance_that_is_not_ready_does_not_release_the_robot(
    fleet: FakeFleet, journal: Journal
) -> None:
    for edge in ("edge1", "edge2"):
        fleet[edge].faults["wait"] = lambda _request: {"state": "failed", "exit_code": 3}
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge1")
    assert result.error.endswith("robot1 STILL HOLDS: no instance of slam is ready")
    assert "check release robot1" not in fleet.world.events


def test_a_restart_that_is_not_ready_does_not_release_the_robot(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].runs("slam")
    fleet["edge1"].faults["wait"] = lambda _request: {"state": "failed", "exit_code": 3}
    task = a_task("slam", robots=["robot1"], handoff=a_contract())
    result = find_result(
        run_steps(
            fleet, journal, a_plan(a_step("slam", Action.RESTART, host="edge1", previous="edge1")), task
        ),
        "slam",
    )
    assert "robot1 STILL HOLDS" in result.error
    assert fleet.world.events[-1] != "check release robot1"


def test_a_stop_that_the_host_refuses_leaves_the_old_one_steering(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].faults["stop"] = RefusedError("another manager was here")
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located, result.error) == (
        Outcome.FAILED,
        "edge1",
        "another manager was here",
    )
    assert fleet.world.events[-1] == "check release robot1"


def test_an_env_command_that_fails_defers_a_move_and_touches_nothing(
    fleet: FakeFleet, journal: Journal
) -> None:
    result = run_move(fleet, journal, a_contract(), env_command=("false",))
    assert (result.outcome, result.located) == (Outcome.DEFERRED, "edge1")
    assert result.error == "env_command of task slam failed with exit code 1"
    assert (fleet.changes, fleet.world.events) == ([], ["check safe_when robot1"])


def test_hooks_on_the_host_run_where_the_task_is(fleet: FakeFleet, journal: Journal) -> None:
    hooks: dict[str, Any] = {
        name: Check(command=name, on=CheckLocation.HOST) for name in ("safe_when", "hold", "release")
    }
    assert run_move(fleet, journal, a_contract(**hooks)).outcome is Outcome.DONE
    checks = [event for event in fleet.world.events if event.startswith("check")]
    assert checks == ["check safe_when edge1", "check hold edge1", "check release edge2"]


def test_each_phase_and_the_downtime_stand_in_the_journal(
    fleet: FakeFleet, journal: Journal, tmp_path: Path
) -> None:
    result = run_move(fleet, journal, a_contract())
    commit = next(entry for entry in read_entries(tmp_path / "journal.jsonl") if entry["event"] == "commit")
    phases = commit["phases"]
    assert isinstance(phases, list)
    assert [entry["phase"] for entry in phases] == ["safe", "hold", "stop", "start", "ready", "release"]
    assert commit["downtime_s"] == result.downtime_s


def be_silent(host: FakeHost, op: str, times: int = 1) -> list[str]:
    """The host carries out requests ``op``, but the first ``times`` replies miss their deadline."""
    asked: list[str] = []
    carry_out = getattr(host, f"_{op}")

    def answer(request: dict[str, object]) -> dict[str, object]:
        asked.append(str(request.get("command", op)))
        reply: dict[str, object] = carry_out(request)
        if len(asked) <= times:
            raise DeadlineError("no answer within 15 s")
        return reply

    host.faults[op] = answer
    return asked


def test_a_robot_that_got_the_hold_and_answered_too_late_is_released(
    fleet: FakeFleet, journal: Journal
) -> None:
    be_silent(fleet["robot1"], "check")
    result = run_move(fleet, journal, a_contract(safe_when=None))
    assert (result.outcome, result.located, fleet.changes) == (Outcome.FAILED, "edge1", [])
    assert result.error == "no answer within 15 s"
    assert fleet.world.events == ["check hold robot1", "check release robot1"]


@pytest.mark.parametrize("order", list(HandoffOrder))
def test_a_new_instance_whose_start_was_answered_too_late_is_taken_away(
    fleet: FakeFleet, journal: Journal, order: HandoffOrder
) -> None:
    """And the old one steers: put back where it was stopped first."""
    be_silent(fleet["edge2"], "start")
    result = run_move(fleet, journal, a_contract(order))
    assert (result.outcome, result.located, fleet.placed) == (Outcome.FAILED, "edge1", {"slam": "edge1"})
    assert fleet.world.events[-1] == "check release robot1"
    assert order is HandoffOrder.START_FIRST or not fleet.world.overlap


def test_the_old_instance_is_put_back_on_a_host_that_was_silent_to_another_task(
    fleet: FakeFleet, journal: Journal
) -> None:
    """Between the stop of slam on edge1 and its failure on edge2, edge1 lets the deadline of a stop pass."""
    moved = threading.Event()

    def fail(_request: dict[str, object]) -> dict[str, object]:
        moved.set()
        deadline = time.monotonic() + 10.0
        while not any(entry["event"] == "commit" for entry in read_entries(journal.path)):
            assert time.monotonic() < deadline
            time.sleep(0.005)
        return {"state": "failed", "exit_code": 3}

    def be_late(_request: dict[str, object]) -> dict[str, object]:
        assert moved.wait(10.0)
        raise DeadlineError("no answer within 15 s")

    fleet["edge2"].faults["wait:slam"], fleet["edge1"].faults["stop:nav"] = fail, be_late
    for name in ("slam", "nav"):
        fleet["edge1"].runs(name)
    steps = (
        a_step("slam", Action.MOVE, host="edge2", previous="edge1"),
        a_step("nav", Action.STOP, previous="edge1"),
    )
    slam = a_task("slam", robots=["robot1"], handoff=a_contract())
    results = run_steps(fleet, journal, a_plan(*steps), slam)
    assert find_result(results, "nav").outcome is Outcome.FAILED
    assert find_result(results, "slam").error == "slam failed (exit code 3) on edge2; restored on edge1"
    assert fleet.placed["slam"] == "edge1"


def test_a_robot_that_stays_silent_is_asked_once_more_in_a_run_however_many_tasks_it_has(
    fleet: FakeFleet, journal: Journal
) -> None:
    asked = be_silent(fleet["robot1"], "check", times=99)
    names = ("slam", "nav", "map")
    for name in names:
        fleet["edge1"].runs(name)
    results = run_steps(
        fleet,
        journal,
        a_plan(*(a_step(name, Action.MOVE, host="edge2", previous="edge1") for name in names)),
        *(a_task(name, robots=["robot1"], handoff=a_contract(safe_when=None)) for name in names),
        max_parallel=1,
    )
    assert {result.outcome for result in results.actions} == {Outcome.FAILED}
    assert asked == ["hold", "release"]


def test_start_first_that_fails_leaves_the_old_one_untouched(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge2"].faults["wait"] = lambda _request: {"state": "crashloop"}
    result = run_move(
        fleet, journal, a_contract(HandoffOrder.START_FIRST, safe_when=None, hold=None, release=None)
    )
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge1")
    assert fleet.changes == ["start slam edge2", "stop slam edge2"]


def test_an_old_instance_that_does_not_stop_keeps_the_new_one_from_starting(
    fleet: FakeFleet, journal: Journal
) -> None:
    fleet["edge1"].faults["stop"] = lambda _request: {"state": "stop-incomplete", "left": [7, 8]}
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge1")
    assert fleet.changes == []
    assert "robot1 STILL HOLDS" in result.error
    assert result.phases[-1].phase is Phase.STOP


def test_a_failed_hold_stops_nothing(fleet: FakeFleet, journal: Journal) -> None:
    fleet["robot1"].checks["hold"] = 5
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge1")
    assert result.error == "hold hook of slam failed on robot1: said by hold"
    assert fleet.changes == []


def test_a_failed_release_says_so_with_the_new_one_running(fleet: FakeFleet, journal: Journal) -> None:
    fleet["robot1"].checks["release"] = 5
    result = run_move(fleet, journal, a_contract())
    assert (result.outcome, result.located) == (Outcome.FAILED, "edge2")


def test_a_restart_stops_and_starts_on_its_host(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].runs("slam")
    made = a_plan(a_step("slam", Action.RESTART, host="edge1", previous="edge1"))
    result = find_result(run_steps(fleet, journal, made, a_task("slam")), "slam")
    assert (result.outcome, result.located) == (Outcome.DONE, "edge1")
    assert fleet.changes == ["stop slam edge1", "start slam edge1"]
    assert result.downtime_s is not None


def test_two_tasks_that_change_places_do_not_wait_for_each_other(fleet: FakeFleet, journal: Journal) -> None:
    fleet["edge1"].runs("a")
    fleet["edge2"].runs("b")
    made = a_plan(
        a_step("a", Action.MOVE, host="edge2", previous="edge1"),
        a_step("b", Action.MOVE, host="edge1", previous="edge2"),
    )
    assert run_steps(fleet, journal, made, a_task("a"), a_task("b")).done
    assert fleet.placed == {"a": "edge2", "b": "edge1"}
