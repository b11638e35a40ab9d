# SPDX-License-Identifier: Apache-2.0
"""Algorithm 2 as a pure diff: an assignment against the running tasks."""

from dataclasses import replace
from typing import Any

import pytest

from edgectl.executor.diff import diff_assignment, plan_from_assignment, select_targets
from edgectl.model.assignment import Assignment, Decision, Reason, Verdict
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Step
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.task import Need, NeedRestart, Task
from edgectl.rules.need_runs import mark_run
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, silent, some_tasks

NOTHING = ManagerState()
EDGES = ("edge1", "edge2", "edge3")


def a_decision(
    verdict: Verdict, reason: Reason, host: str | None = None, before: str | None = None, task: str = "slam"
) -> Decision:
    return Decision(task=task, verdict=verdict, reason=reason, host=host, previous_host=before)


def diff_step(decision: Decision, snapshot: Snapshot, task: Task | None = None) -> Step:
    assignment = Assignment(policy=Policy(), decisions=(decision,), expected={})
    return diff_assignment(assignment, some_tasks(task or a_task()), snapshot, NOTHING)[0]


def a_fleet_snapshot(**runs: TaskSample) -> Snapshot:
    return a_snapshot({edge: a_sample(tasks={"slam": runs[edge]} if edge in runs else {}) for edge in EDGES})


@pytest.mark.parametrize(
    ("decision", "runs", "action", "instances", "stop"),
    [
        (a_decision(Verdict.PLACED, Reason.BEST, "edge1"), {}, Action.START, {}, ()),
        (a_decision(Verdict.PLACED, Reason.BEST, "edge1"), {"edge1": a_run(TaskState.FAILED)}, Action.START, {}, ()),
        (a_decision(Verdict.PLACED, Reason.GAIN, "edge2", "edge1"), {"edge1": a_run()}, Action.MOVE, {"edge1": "instance-1"}, ()),
        (a_decision(Verdict.KEPT, Reason.STILL_BEST, "edge1", "edge1"), {"edge1": a_run()}, Action.KEEP, {}, ()),
        (a_decision(Verdict.HELD, Reason.HOST_SILENT, "edge1", "edge1"), {}, Action.HOLD, {}, ()),
        (a_decision(Verdict.HELD, Reason.ROBOT_SILENT), {}, Action.HOLD, {}, ()),
        (a_decision(Verdict.UNPLACED, Reason.NO_FEASIBLE_HOST), {}, Action.UNPLACED, {}, ()),
        (a_decision(Verdict.COMPLETED, Reason.DONE), {}, Action.NONE, {}, ()),
        (a_decision(Verdict.COMPLETED, Reason.DONE), {"edge1": a_run(TaskState.COMPLETED, pid=0)}, Action.NONE, {}, ()),
        (a_decision(Verdict.COMPLETED, Reason.DONE, None, "edge1"), {"edge1": a_run(TaskState.COMPLETED)}, Action.COMPLETE,
         {"edge1": "instance-1"}, ()),
        (a_decision(Verdict.COMPLETED, Reason.DONE, None, "edge2"), {"edge1": a_run(), "edge2": a_run(instance="b")}, Action.COMPLETE,
         {"edge1": "instance-1", "edge2": "b"}, ("edge1",)),
        # an unwanted copy is stopped, regardless of the rest
        (a_decision(Verdict.KEPT, Reason.STILL_BEST, "edge1", "edge1"), {"edge1": a_run(), "edge2": a_run(instance="b")}, Action.KEEP,
         {"edge2": "b"}, ("edge2",)),
        (a_decision(Verdict.PLACED, Reason.GAIN, "edge3", "edge1"), {"edge1": a_run(), "edge2": a_run(instance="b")}, Action.MOVE,
         {"edge1": "instance-1", "edge2": "b"}, ("edge2",)),
        # the supervisor of a crash loop gave up, but may still exist when the task starts elsewhere
        (a_decision(Verdict.PLACED, Reason.BEST, "edge2"), {"edge1": a_run(TaskState.CRASHLOOP)}, Action.START, {"edge1": "instance-1"},
         ("edge1",)),
        # an older specification completed and its record is still on the host of the new start
        (a_decision(Verdict.PLACED, Reason.BEST, "edge1"), {"edge1": a_run(TaskState.COMPLETED, spec_hash="old")}, Action.RESTART,
         {"edge1": "instance-1"}, ()),
    ],
)  # fmt: skip
def test_actions(
    decision: Decision,
    runs: dict[str, TaskSample],
    action: Action,
    instances: dict[str, str],
    stop: tuple[str, ...],
) -> None:
    assert diff_step(decision, a_fleet_snapshot(**runs)) == Step(
        decision=decision, action=action, instances=instances, stop=stop
    )


@pytest.mark.parametrize(("adoptable", "action"), [(True, Action.ADOPT), (False, Action.RESTART)])
def test_an_orphan_is_adopted_where_it_can_be_and_else_restarted(adoptable: bool, action: Action) -> None:
    kept = a_decision(Verdict.KEPT, Reason.STILL_BEST, "edge1", "edge1")
    step = diff_step(kept, a_fleet_snapshot(edge1=a_run(orphaned=True, adoptable=adoptable)))
    assert (step.action, step.decision.reason) == (action, Reason.ORPHANED)
    assert step.instances == {"edge1": "instance-1"}


@pytest.mark.parametrize(
    ("spec_hash", "action"), [("hash-slam", Action.KEEP), ("older", Action.RESTART), ("", Action.KEEP)]
)
def test_a_changed_specification_restarts_in_place_where_it_is_known(spec_hash: str, action: Action) -> None:
    found = diff_step(
        a_decision(Verdict.KEPT, Reason.STILL_BEST, "edge1", "edge1"),
        a_fleet_snapshot(edge1=a_run(spec_hash=spec_hash)),
    )
    assert found.action is action
    if action is Action.RESTART:
        assert (found.decision.reason, found.instances, found.changed) == (
            Reason.SPEC_CHANGED,
            {"edge1": "instance-1"},
            ("spec",),
        )


@pytest.mark.parametrize(
    ("before", "changed"),
    [
        ({"command": "1", "env": "2"}, ("env",)),
        ({"command": "0", "env": "0", "secrets": "3"}, ("command", "env", "secrets")),
        ({"command": "1"}, ("env",)),
        (
            {"command": "1", "env": "3"},
            ("spec",),
        ),  # the hash differs and no field does: started by an edgectl with other fields
    ],
)
def test_a_restart_says_what_changed(before: dict[str, str], changed: tuple[str, ...]) -> None:
    task = a_task(spec_fields={"command": "1", "env": "3"})
    runs = a_fleet_snapshot(edge1=a_run(spec_hash="older", fields=before))
    assert (
        diff_step(a_decision(Verdict.KEPT, Reason.STILL_BEST, "edge1", "edge1"), runs, task).changed
        == changed
    )


def test_a_move_is_a_move_even_with_a_changed_specification() -> None:
    assert (
        diff_step(
            a_decision(Verdict.PLACED, Reason.GAIN, "edge2", "edge1"),
            a_fleet_snapshot(edge1=a_run(spec_hash="older")),
        ).action
        is Action.MOVE
    )


@pytest.mark.parametrize(
    ("decision", "action"),
    [
        (a_decision(Verdict.KEPT, Reason.UNMANAGED, "edge1", "edge1"), Action.KEEP),
        (a_decision(Verdict.KEPT, Reason.UNMANAGED), Action.NONE),
        (a_decision(Verdict.COMPLETED, Reason.DONE), Action.NONE),
        (a_decision(Verdict.HELD, Reason.HOST_SILENT, "edge3"), Action.HOLD),
    ],
)
def test_nothing_unmanaged_is_ever_stopped(decision: Decision, action: Action) -> None:
    runs = a_fleet_snapshot(edge1=a_run(spec_hash="x"), edge2=a_run(spec_hash="y"))
    found = diff_step(decision, runs, a_task(managed=False))
    assert (found.action, found.instances, found.stop) == (action, {}, ())


def test_tasks_that_left_the_file_are_stopped_last_and_only_if_ours() -> None:
    runs = {
        "old10": a_run(),
        "old2": a_run(),
        "foreign": a_run(managed=False),
        "dead": a_run(TaskState.FAILED),
    }
    snapshot = a_snapshot(
        edge1=a_sample(tasks=runs), edge2=a_sample(tasks={"old2": a_run(instance="b")}), edge3=silent()
    )
    assignment = Assignment(
        policy=Policy(), decisions=(a_decision(Verdict.PLACED, Reason.BEST, "edge1"),), expected={}
    )
    memory = ManagerState(placements={"old2": Placement(host="edge2", since=NOW)})
    start, old2, old10 = diff_assignment(assignment, some_tasks(a_task()), snapshot, memory)
    assert start.action is Action.START
    assert (old2.task, old2.action, old2.decision.reason, old2.decision.previous_host) == (
        "old2",
        Action.STOP,
        Reason.LEFT_FILE,
        "edge2",
    )
    assert (dict(old2.instances), old2.stop) == ({"edge1": "instance-1", "edge2": "b"}, ("edge1",))
    assert (old10.task, old10.decision.host, old10.stop) == ("old10", None, ())


def test_a_plan_can_be_repeated_from_itself() -> None:
    inventory, tasks = an_inventory(an_edge()), some_tasks(a_task())
    snapshot, memory = a_snapshot(edge1=a_sample()), ManagerState(cordons=frozenset({"edge9"}))
    assignment = Assignment(
        policy=Policy(),
        decisions=(a_decision(Verdict.PLACED, Reason.BEST, "edge1"),),
        expected={},
        settled=False,
    )
    plan = plan_from_assignment(inventory, tasks, snapshot, memory, assignment)
    assert (plan.created_at, plan.inventory_digest, plan.tasks_digest) == (
        NOW,
        "inventory-digest",
        "tasks-digest",
    )
    assert plan.snapshot.manager == memory
    assert (plan.settled, plan.summary, plan.changes) == (False, {Action.START: 1}, True)


def test_selecting_targets_shows_all_and_does_some() -> None:
    inventory, tasks = (
        an_inventory(an_edge("edge1"), an_edge("edge2")),
        some_tasks(a_task("a"), a_task("b"), a_task("c")),
    )
    runs: dict[str, Any] = {
        "edge1": a_sample(tasks={"b": a_run(), "c": a_run()}),
        "edge2": a_sample(tasks={"c": a_run()}),
    }
    decisions = (
        a_decision(Verdict.PLACED, Reason.BEST, "edge1", task="a"),
        a_decision(Verdict.PLACED, Reason.GAIN, "edge2", "edge1", task="b"),
        a_decision(Verdict.KEPT, Reason.STILL_BEST, "edge1", "edge1", task="c"),
    )
    assignment = Assignment(policy=Policy(), decisions=decisions, expected={})
    plan = plan_from_assignment(inventory, tasks, a_snapshot(runs), NOTHING, assignment)
    assert [(s.action, s.stop) for s in plan.steps] == [
        (Action.START, ()),
        (Action.MOVE, ()),
        (Action.KEEP, ("edge2",)),
    ]
    chosen = select_targets(plan, {"b"})
    assert [(s.action, s.stop, s.decision) for s in chosen.steps] == [
        (Action.NONE, (), decisions[0]),
        (Action.MOVE, (), decisions[1]),
        (Action.KEEP, (), decisions[2]),
    ]
    assert not select_targets(plan, set()).changes


@pytest.mark.parametrize(
    ("needed", "master", "action"),
    [
        (mark_run("m1", 0), a_run(instance="m1"), Action.KEEP),
        # its supervisor restarted it; it was started anew
        (mark_run("m1", 0), a_run(instance="m1", restarts=1), Action.RESTART),
        (mark_run("m1", 0), a_run(instance="m2"), Action.RESTART),
        # started by an older edgectl, or without this need: nobody knows with which run
        ("", a_run(instance="m2"), Action.KEEP),
        (f"{mark_run('m1', 0)},", a_run(instance="m2"), Action.KEEP),
        # started in this very plan, so the mark is of no use
        (mark_run("m1", 0), None, Action.RESTART),
    ],
)
def test_a_task_restarts_with_its_predecessor(needed: str, master: TaskSample | None, action: Action) -> None:
    tasks = some_tasks(
        a_task("core"), a_task("slam", needs=(Need(task="core", restart=NeedRestart.WITH),)), a_task("nav")
    )
    tasks = replace(
        tasks, tasks={**tasks.tasks, "nav": replace(tasks.tasks["nav"], needs=(Need(task="core"),))}
    )
    runs = {"slam": a_run(needed=needed, spec_hash=""), "nav": a_run(spec_hash="")}
    seen = a_snapshot(
        {"edge1": a_sample(tasks=runs | ({"core": replace(master, spec_hash="")} if master else {}))}
    )
    core = (Verdict.KEPT, Reason.STILL_BEST) if master else (Verdict.PLACED, Reason.BEST)
    decisions = (
        a_decision(*core, "edge1", task="core"),
        *(
            a_decision(Verdict.KEPT, Reason.STILL_BEST, "edge1", "edge1", task=name)
            for name in ("slam", "nav")
        ),
    )
    steps = diff_assignment(
        Assignment(policy=Policy(), decisions=decisions, expected={}), tasks, seen, NOTHING
    )
    assert [step.action for step in steps[1:]] == [action, Action.KEEP]
    if action is Action.RESTART:
        assert (steps[1].decision.reason, steps[1].decision.subject) == (Reason.NEED_RESTARTED, "core")
        assert steps[1].instances == {"edge1": "instance-1"}
