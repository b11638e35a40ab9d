# SPDX-License-Identifier: Apache-2.0
"""The manager state after an apply, case by case."""

import dataclasses

from edgectl.executor.manager_state_update import compute_next_generations, update_manager_state
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy
from edgectl.model.result import ActionResult, Outcome, Phase, PhaseResult, Results
from edgectl.model.snapshot import Snapshot, TaskState
from tests.builders import NOW, TASK_FILE, a_run, a_sample, a_snapshot, a_task, silent, some_tasks

TASKS = some_tasks(a_task("slam"))
OLD = Placement(host="edge1", since=5.0, spec_hash="old", generation=3, file=TASK_FILE)


def a_step(
    action: Action, *, host: str | None = None, previous: str | None = None, verdict: Verdict = Verdict.PLACED
) -> Step:
    return Step(
        decision=Decision(
            task="slam", verdict=verdict, reason=Reason.BEST, host=host, previous_host=previous
        ),
        action=action,
    )


def update_after(
    step: Step,
    *,
    located: str | None = None,
    outcome: Outcome | None = None,
    world: Snapshot | None = None,
    **fields: object,
) -> ManagerState:
    """Return the state that had slam on edge1, after one step; without an outcome the step was not carried
    out.
    """
    plan = Plan(
        created_at=NOW,
        policy=Policy(),
        inventory_digest="",
        tasks_digest="",
        snapshot=world or a_snapshot(edge1=a_sample(), edge2=a_sample()),
        settled=True,
        steps=(step,),
        expected={},
    )
    result = ActionResult(
        task="slam", action=step.action, outcome=outcome or Outcome.DONE, host=step.decision.host, located=located, **fields  # type: ignore[arg-type]
    )  # fmt: skip
    results = Results(revision=1, actions=(result,) if outcome else (), seconds=0.0)
    return update_manager_state(
        ManagerState(placements={"slam": OLD}), plan, TASKS, results, {"slam": 9}, NOW
    )


def test_a_start_is_a_new_place() -> None:
    memory = update_after(a_step(Action.START, host="edge2"), outcome=Outcome.DONE, located="edge2")
    assert memory.placements == {
        "slam": Placement(host="edge2", since=NOW, spec_hash="hash-slam", generation=9, file=TASK_FILE)
    }
    assert memory.managed
    assert memory.first == {"slam": "edge2"}


def test_a_restart_keeps_its_dwell() -> None:
    memory = update_after(
        a_step(Action.RESTART, host="edge1", previous="edge1"),
        outcome=Outcome.DONE,
        located="edge1",
        downtime_s=0.5,
    )
    assert memory.placements["slam"] == Placement(
        host="edge1", since=5.0, spec_hash="hash-slam", generation=9, file=TASK_FILE
    )
    assert memory.downtimes == {("slam", "edge1"): (0.5,)}


def test_a_move_tells_its_downtime_and_how_long_the_task_had_been_where_it_was() -> None:
    step = a_step(Action.MOVE, host="edge2", previous="edge1")
    memory = update_after(step, outcome=Outcome.DONE, located="edge2", previous_host="edge1", downtime_s=2.5)
    assert memory.downtimes == {("slam", "edge2"): (2.5,)}
    assert memory.stays == {"slam": (NOW - 5.0,)}


def test_a_restored_task_measures_no_move() -> None:
    step = a_step(Action.MOVE, host="edge2", previous="edge1")
    memory = update_after(
        step, outcome=Outcome.FAILED, located="edge1", previous_host="edge1", downtime_s=60.0
    )
    assert (memory.downtimes, memory.stays) == ({}, {})


def test_a_stopped_task_is_forgotten_and_a_deferred_one_is_not() -> None:
    assert update_after(a_step(Action.STOP, previous="edge1"), outcome=Outcome.DONE).placements == {}
    move = a_step(Action.MOVE, host="edge2", previous="edge1")
    assert update_after(move, outcome=Outcome.DEFERRED, located="edge1").placements == {"slam": OLD}


def test_a_restored_task_has_a_generation_of_its_own() -> None:
    phases = (PhaseResult(phase=Phase.RESTORE, host="edge1", seconds=0.1, ok=True),)
    memory = update_after(
        a_step(Action.MOVE, host="edge2", previous="edge1"),
        outcome=Outcome.FAILED,
        located="edge1",
        phases=phases,
    )
    assert (memory.placements["slam"].since, memory.placements["slam"].generation) == (5.0, 10)


def test_a_silent_host_keeps_its_tasks_and_one_that_answers_does_not() -> None:
    hold = a_step(Action.HOLD, host="edge1", verdict=Verdict.HELD)
    assert update_after(hold, world=a_snapshot(edge1=silent(), edge2=a_sample())).placements == {"slam": OLD}
    unplaced = a_step(Action.UNPLACED, verdict=Verdict.UNPLACED)
    assert update_after(unplaced).placements == {}


def test_an_untouched_task_is_where_the_snapshot_shows_it() -> None:
    run = a_run(spec_hash="seen", generation=4)
    world = a_snapshot(edge1=a_sample(), edge2=a_sample(tasks={"slam": run}))
    memory = update_after(a_step(Action.KEEP, host="edge2"), world=world)
    assert memory.placements["slam"] == Placement(
        host="edge2",
        since=run.started_at,
        spec_hash="seen",
        generation=4,
        file=TASK_FILE,
        instance="instance-1",
    )


def test_completed_tasks_are_marked_by_their_specification() -> None:
    complete = a_step(Action.COMPLETE, previous="edge1", verdict=Verdict.COMPLETED)
    assert update_after(complete, outcome=Outcome.DONE).done == {"slam": "hash-slam"}
    assert update_after(complete, outcome=Outcome.FAILED, located="edge1").done == {}
    assert update_after(a_step(Action.NONE, verdict=Verdict.COMPLETED)).done == {"slam": "hash-slam"}


def test_the_journal_knows_generations_that_nobody_else_does() -> None:
    """The task runs nowhere, its host keeps the generation, and the clock went back."""
    decision = Decision(task="slam", verdict=Verdict.PLACED, reason=Reason.BEST, host="edge1")
    steps = (Step(decision=decision, action=Action.START),)
    assert compute_next_generations(ManagerState(), a_snapshot(), steps, 5.0, {"slam": 90}) == {"slam": 91}


def test_generations_are_above_all_that_is_known_and_never_below_the_clock() -> None:
    steps = (a_step(Action.START, host="edge1"),)
    far = int(NOW) + 500
    world = a_snapshot(edge1=a_sample(tasks={"slam": a_run(TaskState.FAILED, generation=far)}))
    assert compute_next_generations(ManagerState(), a_snapshot(), steps, NOW) == {"slam": int(NOW)}
    assert compute_next_generations(ManagerState(), world, steps, NOW) == {"slam": far + 1}
    stopped = a_snapshot(edge1=dataclasses.replace(a_sample(), generations={"slam": far}))
    assert compute_next_generations(ManagerState(), stopped, steps, NOW) == {"slam": far + 1}
    known = ManagerState(placements={"slam": Placement(host="edge1", since=0.0, generation=far + 7)})
    assert compute_next_generations(known, world, steps, NOW) == {"slam": far + 8}


def test_one_host_cannot_make_the_others_unusable_by_a_generation() -> None:
    steps = (a_step(Action.START, host="edge1"),)
    liar = a_snapshot(edge2=a_sample(tasks={"slam": a_run(generation=2**63)}), edge1=a_sample())
    assert compute_next_generations(ManagerState(), liar, steps, NOW) == {"slam": int(NOW)}
    memory = update_after(a_step(Action.KEEP, host="edge1"), world=a_snapshot(edge1=liar.hosts["edge2"]))
    assert memory.placements["slam"].generation == OLD.generation
    behind = a_snapshot(edge1=dataclasses.replace(a_sample(), generations={"slam": int(NOW)}))
    assert compute_next_generations(ManagerState(), behind, steps, 5.0) == {"slam": int(NOW) + 1}
