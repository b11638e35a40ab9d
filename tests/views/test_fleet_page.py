# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace
from typing import Any

import pytest

from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, Outcome, Phase, PhaseResult
from edgectl.model.revision import Revision
from edgectl.model.snapshot import TaskState
from edgectl.views.fleet_page import MAX_MOVES, FleetPage, FleetPicture
from edgectl.views.status import StatusView
from edgectl.web.picture import build_page_document
from tests.builders import (
    NOW,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)
from tests.views import fixtures


def a_picture() -> FleetPicture:
    """The committed snapshot and its plan."""
    inventory, tasks, _ = fixtures.fleet()
    plan = fixtures.plan()
    return FleetPicture(snapshot=plan.snapshot, inventory=inventory, tasks=tasks, plan=plan)


def build_item(picture: FleetPicture) -> dict[str, Any]:
    """The values of the page."""
    item = FleetPage(picture).build_document()["item"]
    assert isinstance(item, dict)
    return item


def test_the_tasks_are_the_rows_of_status_with_the_reason_of_the_plan() -> None:
    picture = a_picture()
    rows = StatusView(picture.snapshot, picture.inventory, picture.tasks).document()["items"]
    page = build_item(picture)
    assert isinstance(rows, list)
    assert rows
    plan = {step.task: step for step in fixtures.plan().steps}
    for row, shown in zip(rows, page["tasks"], strict=True):
        assert row.items() <= shown.items()
        assert shown["reason"].startswith(plan[row["task"]].action.value)
        assert shown["next_host"] == plan[row["task"]].decision.host


def test_a_host_has_what_it_uses_and_what_its_tasks_reserve() -> None:
    picture = a_picture()
    for host in build_item(picture)["hosts"]:
        sample = picture.snapshot.hosts[host["host"]]
        assert host["cpu"]["used_cores"] == pytest.approx(sample.usage["cpu"].used, rel=1e-5)
        here = [step.decision.demand for step in fixtures.plan().steps if step.decision.host == host["host"]]
        wanted = sum(rho.value for demand in here for rho in demand if rho.resource.name == "memory")
        assert host["memory"]["reserved_bytes"] == pytest.approx(wanted, rel=1e-5)


def test_a_silent_host_a_failed_task_and_no_plan_are_shown_without_any_output_of_the_task() -> None:
    inventory = an_inventory(an_edge("zeta"), an_edge("beta"), an_edge("alpha"), a_robot())
    tasks = some_tasks(a_task("slam"), a_task("detect"))
    failed = a_run(TaskState.FAILED, log_tail=("password is hunter2",), exit_code=1)
    snapshot = a_snapshot(zeta=a_sample(tasks={"slam": failed}), beta=silent(), alpha=a_sample())
    picture = FleetPicture(snapshot=snapshot, inventory=inventory, tasks=tasks, plan_error="no <plan>")
    text = json.dumps(FleetPage(picture).build_document())
    assert "hunter2" not in text
    page = build_item(picture)
    assert page["plan_error"] == "no <plan>"
    assert {host["host"]: host["status"] for host in page["hosts"]} == {
        "alpha": "ok", "beta": "unreachable", "zeta": "ok", "robot1": "not probed",
    }  # fmt: skip
    assert any("slam on zeta" in line for line in page["problems"])
    assert next(row for row in page["tasks"] if row["task"] == "slam")["attention"] == "failed"


def test_moves_are_the_last_actions_with_their_phases() -> None:
    def a_revision(number: int) -> Revision:
        phases = (
            PhaseResult(phase=Phase.STOP, host="edge1", seconds=0.5, ok=True),
            PhaseResult(phase=Phase.READY, host="edge2", seconds=1.5, ok=False),
        )
        move = ActionResult(
            task=f"task{number}", action=Action.MOVE, outcome=Outcome.FAILED, host="edge2",
            previous_host="edge1", phases=phases, downtime_s=2.0, error="never ready",
        )  # fmt: skip
        skipped = ActionResult(task="other", action=Action.START, outcome=Outcome.SKIPPED)
        return Revision(
            number=number, began_at=NOW + number, user="ana", verb="apply", actions=(move, skipped)
        )

    revisions = [a_revision(number) for number in range(1, MAX_MOVES + 5)]
    moves = build_item(replace(a_picture(), revisions=revisions))["moves"]
    assert [move["revision"] for move in moves] == list(range(MAX_MOVES + 4, 4, -1))
    assert [(phase["phase"], phase["duration_s"]) for phase in moves[0]["phases"]] == [
        ("stop", 0.5),
        ("ready", 1.5),
    ]
    assert (moves[0]["downtime_s"], moves[0]["error"], moves[0]["user"]) == (2, "never ready", "ana")


def test_secrets_of_the_files_are_masked_wherever_a_host_writes_them() -> None:
    hosts = {"edge1": replace(silent(), error="denied: s3cr3t-value", hint="try s3cr3t-value")}
    picture = FleetPicture(
        snapshot=a_snapshot(hosts, edge2=a_sample(tasks={"slam": a_run(detail="s3cr3t-value")})),
        inventory=an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot()),
        tasks=some_tasks(a_task("slam")),
    )
    assert "s3cr3t-value" in json.dumps(build_page_document(picture, ()))
    hidden = json.dumps(build_page_document(picture, ("s3cr3t-value",)))
    assert "s3cr3t-value" not in hidden
    assert hidden.count("***") >= 3
