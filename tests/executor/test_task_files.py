# SPDX-License-Identifier: Apache-2.0
"""Task files that are given one at a time: what a run stops, leaves alone and counts (ADR 0039)."""

from dataclasses import replace

import pytest

from edgectl.executor.diff import plan_from_assignment
from edgectl.model.assignment import Assignment, Reason
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy
from edgectl.model.task import Tasks
from edgectl.scheduler.assign import assign
from edgectl.views.plan_sections import list_plan_notes
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks

INVENTORY = an_inventory(an_edge())


def plan_beside(
    file: str, *, given: Tasks, remembered: str | None = None, prune: bool = False, used: float = 0.0
) -> Plan:
    """The plan of ``given`` while the task ``nav``, started from ``file``, runs and uses ``used`` cores."""
    run = a_run(file=file)
    run = replace(run, used=type(run.used)(cpu=used))
    snapshot = a_snapshot(edge1=a_sample(cores=2.0, used=used, tasks={"nav": run}))
    placements = {"nav": Placement(host="edge1", since=NOW, file=remembered)} if remembered else {}
    manager = ManagerState(managed=True, placements=placements)
    policy = Policy(prune=prune)
    assignment: Assignment = assign(INVENTORY, given, snapshot, manager, policy, NOW)
    return plan_from_assignment(INVENTORY, given, snapshot, manager, assignment)


SLAM = replace(some_tasks(a_task("slam", cpu=1.0)), files=frozenset({"slam.yaml"}))


@pytest.mark.parametrize(
    ("file", "remembered", "given", "prune", "reason"),
    [
        # The defect: `apply -t slam.yaml` after `apply -t nav.yaml` stopped what nav.yaml lists.
        ("nav.yaml", None, SLAM, False, None),
        ("slam.yaml", None, SLAM, False, Reason.LEFT_FILE),
        ("nav.yaml", None, SLAM, True, Reason.PRUNED),
        # A task that moved to another file belongs to the one that listed it last.
        ("slam.yaml", "nav.yaml", SLAM, False, None),
        ("nav.yaml", "slam.yaml", SLAM, False, Reason.LEFT_FILE),
        # Started by an edgectl that knew no files: nobody can say that its file was given.
        ("", None, SLAM, False, None),
        ("", None, SLAM, True, Reason.PRUNED),
        # A directory stands for its files, also for those that were deleted, and not for those below it.
        ("../tasks/old.yaml", None, replace(SLAM, folders=frozenset({"../tasks"})), False, Reason.LEFT_FILE),
        ("../tasks/sub/old.yaml", None, replace(SLAM, folders=frozenset({"../tasks"})), False, None),
        ("old.yaml", None, replace(SLAM, folders=frozenset({"."})), False, Reason.LEFT_FILE),
    ],
)
def test_only_tasks_of_given_files_are_stopped(
    file: str, remembered: str | None, given: Tasks, prune: bool, reason: Reason | None
) -> None:
    plan = plan_beside(file, given=given, remembered=remembered, prune=prune)
    stops = {step.task: step.decision.reason for step in plan.steps if step.task == "nav"}
    assert stops == ({} if reason is None else {"nav": reason})
    assert dict(plan.tasks_left_alone) == ({"nav": remembered or file} if reason is None else {})


def test_what_runs_on_keeps_its_load() -> None:
    """A task that is left alone uses its host; one that is stopped makes room."""
    beside = plan_beside("nav.yaml", given=SLAM, used=1.5)
    instead = plan_beside("nav.yaml", given=SLAM, used=1.5, prune=True)
    assert [step.decision.host for step in beside.steps] == [None]
    assert [step.decision.host for step in instead.steps] == ["edge1", None]


def test_the_plan_says_what_it_leaves_alone() -> None:
    plan = plan_beside("nav.yaml", given=SLAM)
    assert list_plan_notes(plan) == ["1 task of another file (nav.yaml) runs on; --prune stops it: nav"]
    three = replace(plan, tasks_left_alone={"a": "x.yaml", "b": "x.yaml", "c": ""})
    assert list_plan_notes(three) == [
        "3 tasks of other files (x.yaml) run on; --prune stops them: a, b and c"
    ]
    # A host of the fleet may report as many as fit into a reply, each of a file of its own.
    many = replace(plan, tasks_left_alone={f"t{number}": f"x{number}.yaml" for number in range(2000)})
    (note,) = list_plan_notes(many)
    assert note == (
        "2000 tasks of other files (x0.yaml, x1.yaml, x2.yaml, x3.yaml, x4.yaml and 1995 more) run on; "
        "--prune stops them: t0, t1, t2, t3, t4 and 1995 more"
    )
