# SPDX-License-Identifier: Apache-2.0
"""Inactive copies in the views: plan, status, listing, top, description and explanation."""

import json
from dataclasses import replace

import pytest

from edgectl.executor.diff import plan_from_assignment
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy, Weights
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.model.standby import SaveMoment, StateRule
from edgectl.model.task import Tasks
from edgectl.scheduler.assign import assign
from edgectl.scheduler.explain import explain_decision
from edgectl.views.describe_host import HostDetailsView
from edgectl.views.describe_task import TaskDetailsView
from edgectl.views.explanation import ExplanationView
from edgectl.views.listing import ListingView
from edgectl.views.listing_items import ListingKind, build_listing
from edgectl.views.output import View, render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.plan import PlanView
from edgectl.views.status import StatusView
from edgectl.views.top_tasks import TopTasksView
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
from tests.scheduler.test_standbys import SLAM, a_copy, a_task_run

MI = 2.0**20
PLAN = """\
Fleet unnamed, weights cpu, snapshot of 2025-11-21T01:53:20Z

   TASK       NOW    NEXT   UTILITY    LEAD  REASON
+  nav        -      edge2    0.725     tie  start: tie with edge1; chosen by the tie rule
+    standby  -      edge1    0.725          start: the best host besides that of the task; 1.0Gi reserved
!    standby  -      -            -          no standby: no room on edge3, the best host left
=  slam       edge1  edge1    0.750  +0.275  keep: still the best host
+    standby  -      edge2    0.475          start: the best host besides that of the task; 400.0Mi reserved

Expected load after this plan:
HOST   CPU         MEMORY         LINKS
edge1  1.00 (25%)  2.0Gi (50%)    -
edge2  1.10 (28%)  400.0Mi (10%)  -
edge3  2.00 (50%)  3.5Gi (88%)    -

Plan: 1 to start, 0 to move, 0 to stop, 1 kept, 0 unplaced, 2 standbys to start, 1 standby without a host.
"""
INVENTORY = an_inventory(*map(an_edge, ("edge1", "edge2", "edge3")))
POLICY = Policy(weights=Weights(cpu=1.0, memory=0.0, network=0.0, task=0.0))
MANAGER = ManagerState(managed=True, downtimes={("slam", "edge2"): (0.018, 0.02, 0.03)})
TASKS = some_tasks(SLAM, a_task("nav", cpu=0.1, standby=a_standby_rule(hosts=2, memory=GI)), policy=POLICY)


def a_fleet(copy: TaskSample | None = None, *, at: str = "edge2") -> Snapshot:
    hosts: dict[str, HostSample] = {
        "edge1": a_sample(used=1.0, used_memory=GI, tasks={"slam": a_task_run()}),
        "edge2": a_sample(used=1.0),
        "edge3": a_sample(used=2.0, used_memory=3.5 * GI),
    }
    if copy is not None:
        hosts[at] = replace(hosts[at], standbys={"slam": copy})
    return a_snapshot(hosts, memory=MANAGER)


def make_plan(snapshot: Snapshot, tasks: Tasks = TASKS, inventory: Inventory = INVENTORY) -> Plan:
    found = assign(inventory, tasks, snapshot, MANAGER, POLICY, NOW)
    return plan_from_assignment(inventory, tasks, snapshot, MANAGER, found)


def show(view: View, form: OutputFormat = OutputFormat.TABLE) -> str:
    return render_view(view, form)


def test_a_plan_shows_each_copy_below_its_task() -> None:
    assert show(PlanView(make_plan(a_fleet()))) == PLAN


@pytest.mark.parametrize("form", [OutputFormat.WIDE, OutputFormat.MARKDOWN])
def test_every_form_of_a_plan_has_the_copies(form: OutputFormat) -> None:
    text = show(PlanView(make_plan(a_fleet())), form)
    assert "400.0Mi reserved" in text
    assert "no room on edge3" in text


def test_a_plan_that_only_starts_a_copy_is_a_change() -> None:
    only = some_tasks(SLAM, policy=POLICY)
    text = show(PlanView(make_plan(a_fleet(), only)))
    assert "No changes" not in text
    assert text.endswith("1 kept, 0 unplaced, 1 standby to start.\n")
    settled = show(PlanView(make_plan(a_fleet(a_copy()), only)))
    assert settled.endswith("No changes. 1 task is where it should be.\n")


def test_a_failover_is_told() -> None:
    gone = a_fleet(a_copy())
    hosts = {**gone.hosts, "edge1": a_sample()}
    text = show(PlanView(make_plan(replace(gone, hosts=hosts))))
    assert "start: its standby on edge2 becomes active" in text
    assert "activate: it becomes the task" in text


@pytest.mark.parametrize(
    ("copy", "word", "fault"),
    [
        (a_copy(), "standby", ""),
        (a_copy(state=TaskState.STARTING, started_at=NOW - 12.0), "standby, starting", "slam on edge2 (starting for 12s)"),
        (a_copy(state=TaskState.UNHEALTHY), "standby, unhealthy", "slam on edge2 (unhealthy for 1h00m)"),
        (
            a_copy(state=TaskState.CRASHLOOP, given_up=True, last_exit=7, restarts=5),
            "standby, failed (5 restarts, last exit 7)",
            "slam on edge2 (failed (5 restarts, last exit 7))",
        ),
    ],
    ids=["ready", "starting", "unhealthy", "failed"],
)  # fmt: skip
def test_the_status_says_what_is_wrong_with_a_copy(copy: TaskSample, word: str, fault: str) -> None:
    tasks = some_tasks(SLAM)
    view = StatusView(a_fleet(copy), INVENTORY, tasks)
    text = show(view)
    rows = [line.split()[:2] for line in text.splitlines()]
    assert rows.index(["slam", "edge2"]) == rows.index(["slam", "edge1"]) + 1
    assert word in text
    assert ("not ready as standby" in text) is bool(fault)
    assert fault in text
    (item,) = [each for each in json.loads(show(view, OutputFormat.JSON))["items"] if each.get("standby")]
    assert (item["task"], item["host"], item["standby"]) == ("slam", "edge2", True)
    assert bool(item.get("attention")) is bool(fault)
    assert show(view, OutputFormat.WIDE).count("edge2") >= 1


def test_the_status_says_which_tasks_lack_copies() -> None:
    text = show(StatusView(a_fleet(), INVENTORY, TASKS))
    assert text.splitlines()[1] == "not ready as standby: slam has 0 of 1"
    without = some_tasks(replace(SLAM, standby=None))
    assert "standby" not in show(StatusView(a_fleet(), INVENTORY, without))


def test_a_task_whose_copy_alone_is_left_does_not_run() -> None:
    hosts = {"edge2": a_sample(standbys={"slam": a_copy()})}
    text = show(StatusView(a_snapshot(hosts), INVENTORY, some_tasks(SLAM)))
    assert "not running" in text
    assert [line.split()[1] for line in text.splitlines() if line.startswith("slam")] == ["-", "edge2"]


def test_copies_are_listed_and_metered() -> None:
    fleet = a_fleet(a_copy())
    listing = build_listing(ListingKind.TASKS, fleet, INVENTORY, TASKS)
    assert "standby" in show(ListingView(listing))
    top = show(TopTasksView(fleet, INVENTORY, TASKS, []))
    (line,) = [each for each in top.splitlines() if "edge2" in each]
    assert line.split()[-1] == "standby"
    described = show(HostDetailsView("edge2", fleet, INVENTORY, TASKS, None))
    assert "standby" in described


def test_a_task_is_described_with_its_copies() -> None:
    fleet = a_fleet(a_copy())
    slam = replace(SLAM, state=StateRule(topic="/map", moment=SaveMoment.ACTIVE))
    (step,) = [each for each in make_plan(fleet).steps if each.task == "slam"]
    view = TaskDetailsView("slam", fleet, INVENTORY, some_tasks(slam), step, None)
    text = show(view)
    for line in (
        "on 1 host; activate 'wake'; deactivate 'sleep'",
        "topic /map",
        "keep: still the best host besides that of the task; 400.0Mi reserved",
        "Standby on edge2",
    ):
        assert line in text
    (copy,) = json.loads(show(view, OutputFormat.JSON))["item"]["standbys"]
    assert (copy["host"], copy["standby"], copy["instance"]) == ("edge2", True, "copy-1")


def test_an_explanation_says_what_a_copy_costs_and_saves() -> None:
    fleet = a_fleet(a_copy(used=Usage()))
    (step,) = [each for each in make_plan(fleet).steps if each.task == "slam"]
    found = explain_decision(INVENTORY, SLAM, fleet, step.decision, POLICY)
    view = ExplanationView(step, found, (), MANAGER)
    assert "Standby on edge2 (keep): 400.0Mi reserved; would be active in 20ms." in show(view).replace(
        "\n", " "
    )
    (copy,) = json.loads(show(view, OutputFormat.JSON))["item"]["standbys"]
    assert copy["memory"] == {"demand_bytes": 400 * MI}


def test_a_copy_in_the_snapshot_is_no_running_task() -> None:
    only = a_snapshot({"edge2": a_sample(standbys={"x": a_run()})})
    assert show(StatusView(only, INVENTORY, some_tasks())).count("\n") >= 2
