# SPDX-License-Identifier: Apache-2.0
"""diff: what apply would change, and its exit codes, which differ from those of other commands."""

import json
from collections.abc import Mapping
from pathlib import Path

from edgectl.cli.errors import handle_error
from edgectl.errors import StateError
from edgectl.executor.diff import plan_from_assignment
from edgectl.model.manager_state import ManagerState, Pin, Placement
from edgectl.model.plan import Plan
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task
from edgectl.views.diff import DiffView
from tests.builders import (
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
from tests.cli.conftest import Run
from tests.cli.test_plan import mark_unreachable
from tests.scheduler.fleets import run_assign

EDGES = ["edge3", "edge2", "edge1"]
FLEET = an_inventory(*map(an_edge, EDGES))
DIFF = ("diff", "--snapshot", "snap.json")


def plan(running: Mapping[str, tuple[str, str]], *tasks: Task, pins: Mapping[str, str]) -> Plan:
    """A plan where ``running`` says on which host, and of which specification, each task runs."""
    hosts = {
        edge: a_sample(
            tasks={
                name: a_run(spec_hash=spec, instance=f"{name}-1")
                for name, (host, spec) in running.items()
                if host == edge
            }
        )
        for edge in EDGES
    }
    manager = ManagerState(
        managed=True,
        placements={name: Placement(host=host, since=NOW - 3600.0) for name, (host, _) in running.items()},
        pins={name: Pin(host=host, since=NOW) for name, host in pins.items()},
    )
    snapshot: Snapshot = a_snapshot(hosts, memory=manager)
    given = some_tasks(*tasks)
    assignment = run_assign(FLEET, given, snapshot, memory=manager)
    return plan_from_assignment(FLEET, given, snapshot, manager, assignment)


def test_each_task_that_differs_with_what_runs_and_what_would_run() -> None:
    made = plan(
        {
            "slam": ("edge3", "hash-slam"),
            "nav": ("edge2", "older"),
            "gone": ("edge1", "hash-gone"),
            "same": ("edge1", "hash-same"),
        },
        a_task("slam", cpu=0.1),
        a_task("nav", cpu=0.1, pin="edge2"),
        a_task("fresh", cpu=0.1, pin="edge3"),
        a_task("same", cpu=0.1, pin="edge1"),
        a_task("twin", cpu=0.1, never=["edge3"], standby=a_standby_rule()),
        pins={"slam": "edge2"},
    )
    said = DiffView(made).table()
    assert said.splitlines()[:2] == ["--- running", "+++ planned"]
    for lines in (
        "@@ slam: move: pinned to edge2 by edgectl move @@\n-slam on edge3\n+slam on edge2\n",
        "@@ nav: restart: its spec changed @@\n-nav on edge2\n+nav on edge2\n",
        "@@ fresh: start: pinned to edge3 @@\n+fresh on edge3\n",
        "-gone on edge1\n",
        "+twin on edge1\n+twin standby on edge2\n",
    ):
        assert lines in said
    assert "same" not in said
    assert DiffView(made).names() == ["task/fresh", "task/nav", "task/slam", "task/twin", "task/gone"]


def test_nothing_differs() -> None:
    made = plan({"slam": ("edge2", "hash-slam")}, a_task("slam", cpu=0.1), pins={"slam": "edge2"})
    assert DiffView(made).table() == ""


def test_exit_codes_as_of_diff(run: Run, site: Path) -> None:
    """0: nothing, 1: changes, more: an error, also one that is 1 elsewhere."""
    assert run(*DIFF).code == 1
    kept = run(*DIFF, "--target", "slam-robot1")
    assert (kept.code, kept.out) == (0, "")
    assert [handle_error(StateError("damaged"), [verb]) for verb in ("plan", "diff")] == [1, 70]
    assert run("diff", "--nonsense").code == 64
    mark_unreachable(site, "edge3")
    assert run(*DIFF).code == 4
    assert run(*DIFF, "--allow-unreachable").code == 1


def test_documents_have_the_same_lines(run: Run, site: Path) -> None:
    items = json.loads(run(*DIFF, "-o", "json").out)["items"]
    printed = run(*DIFF).out.splitlines()
    assert [line for item in items for line in item["lines"]] == [
        line for line in printed[2:] if not line.startswith("@@")
    ]
