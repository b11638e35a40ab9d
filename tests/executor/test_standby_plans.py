# SPDX-License-Identifier: Apache-2.0
"""Plans of operators, and the checks of saved plans, with inactive copies about."""

from dataclasses import replace

from edgectl.executor.diff import plan_from_assignment, select_targets
from edgectl.executor.drift import list_drift
from edgectl.executor.operator_plans import (
    build_restart_plan,
    build_rollback_plan,
    build_stop_plan,
    drop_given_up_runs,
)
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action, Plan
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.standby_plan import StandbyAction
from edgectl.scheduler.assign import assign
from edgectl.usecases.saved_plan import list_file_conflicts, list_unsafe_steps
from tests.builders import (
    GI,
    NOW,
    a_run,
    a_sample,
    a_snapshot,
    a_standby_rule,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)

MANAGER = ManagerState(managed=True)
INVENTORY = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"))
TASKS = some_tasks(a_task("slam", cpu=1.0, standby=a_standby_rule(memory=GI)), a_task("nav", cpu=0.1))
RUN = a_run(spec_hash="hash-slam", instance="run")
COPY = a_run(spec_hash="hash-slam", instance="copy")


def a_fleet(run: TaskSample | None = RUN, copy: TaskSample | None = COPY, *, at: str = "edge2") -> Snapshot:
    hosts = {name: a_sample(used=float(number)) for number, name in enumerate(("edge1", "edge2", "edge3"))}
    if run is not None:
        hosts["edge1"] = replace(hosts["edge1"], tasks={"slam": run})
    if copy is not None:
        hosts[at] = replace(hosts[at], standbys={"slam": copy})
    return a_snapshot(hosts, memory=MANAGER)


def make_plan(snapshot: Snapshot) -> Plan:
    found = assign(INVENTORY, TASKS, snapshot, MANAGER, TASKS.policy, NOW)
    return plan_from_assignment(INVENTORY, TASKS, snapshot, MANAGER, found)


def list_copy_steps(plan: Plan, task: str = "slam") -> list[tuple[str | None, StandbyAction, str]]:
    return [
        (each.host, each.action, each.instance)
        for step in plan.steps
        if step.task == task
        for each in step.standbys
    ]


def test_a_stopped_task_takes_its_copies_along() -> None:
    plan = build_stop_plan(["slam"], INVENTORY, TASKS, a_fleet())
    (step,) = plan.steps
    assert (step.action, step.instances) == (Action.STOP, {"edge1": "run"})
    assert list_copy_steps(plan) == [("edge2", StandbyAction.STOP, "copy")]


def test_a_copy_alone_is_stopped_too() -> None:
    plan = build_stop_plan(["slam", "nav"], INVENTORY, TASKS, a_fleet(None))
    (step,) = plan.steps
    assert (step.action, step.changes, plan.changes) == (Action.NONE, True, True)
    assert list_copy_steps(plan) == [("edge2", StandbyAction.STOP, "copy")]


def test_a_restart_leaves_copies_alone() -> None:
    plan = build_restart_plan(["slam"], INVENTORY, TASKS, a_fleet())
    assert [step.action for step in plan.steps] == [Action.RESTART]
    assert not list_copy_steps(plan)


def test_a_restart_forgets_a_copy_that_failed() -> None:
    failed = replace(COPY, state=TaskState.FAILED, given_up=True, generation=4)
    left = drop_given_up_runs("slam", a_fleet(copy=failed)).hosts["edge2"]
    assert (left.standbys, left.generations) == ({}, {"slam": 4})


def test_a_rollback_to_a_time_before_the_task_stops_its_copies() -> None:
    made = build_rollback_plan(make_plan(a_fleet()), {"nav": "edge1"}, 3)
    (slam,) = [step for step in made.steps if step.task == "slam"]
    assert slam.action is Action.STOP
    assert list_copy_steps(made) == [("edge2", StandbyAction.STOP, "copy")]
    alone = build_rollback_plan(make_plan(a_fleet(None)), {"nav": "edge1"}, 3)
    assert list_copy_steps(alone) == [("edge2", StandbyAction.STOP, "copy")]
    kept = build_rollback_plan(make_plan(a_fleet()), {"slam": "edge1", "nav": "edge1"}, 3)
    assert list_copy_steps(kept) == [("edge2", StandbyAction.KEEP, "copy")]


def test_a_plan_of_one_task_leaves_the_copies_of_others_alone() -> None:
    made = make_plan(a_fleet(copy=None))
    assert list_copy_steps(made) == [("edge2", StandbyAction.START, "")]
    assert not list_copy_steps(select_targets(made, ["nav"]))
    assert list_copy_steps(select_targets(made, ["slam"]))


def test_a_copy_that_came_or_went_since_makes_a_saved_plan_stale() -> None:
    saved = make_plan(a_fleet())
    assert not list_drift(saved, a_fleet(), MANAGER)
    assert list_drift(saved, a_fleet(copy=None), MANAGER) == ("the standby of slam on edge2 changed",)


def test_a_crafted_plan_starts_no_copy_that_is_not_planned() -> None:
    snapshot = a_fleet(copy=None)
    saved = make_plan(snapshot)
    assert not list_unsafe_steps(saved, INVENTORY, TASKS, snapshot)

    def craft(**fields: object) -> Plan:
        steps = tuple(
            replace(step, standbys=tuple(replace(each, **fields) for each in step.standbys))  # type: ignore[arg-type]
            for step in saved.steps
        )
        return replace(saved, steps=steps)

    (conflict,) = list_unsafe_steps(craft(host="edge3"), INVENTORY, TASKS, snapshot)
    assert conflict == "start of the standby of slam on edge3 is not planned now"
    (conflict,) = list_unsafe_steps(craft(action=StandbyAction.STOP), INVENTORY, TASKS, snapshot)
    assert "is not planned now" in conflict
    found = list_file_conflicts(craft(host="edge9"), INVENTORY, TASKS)
    assert any(line.startswith("edge9 ") for line in found)
    other = replace(some_tasks(a_task("nav", cpu=0.1)), digest=TASKS.digest)
    kept = replace(saved, steps=tuple(replace(step, action=Action.NONE) for step in saved.steps))
    assert "slam is not in the task files" in list_file_conflicts(kept, INVENTORY, other)
