# SPDX-License-Identifier: Apache-2.0
"""How the history, closed hosts and silent hosts are shown."""

import json

import pytest
import yaml

from edgectl.cli import exit_codes
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, CarriedState, Outcome, Phase, PhaseResult
from edgectl.model.revision import Revision, RevisionOutcome
from edgectl.views import plan_sections
from edgectl.views.history import HistoryView, RevisionView
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.snapshot import SnapshotView
from edgectl.views.status import StatusView
from tests.builders import NOW, a_sample, a_snapshot, a_task, an_edge, an_inventory, silent, some_tasks
from tests.views.fixtures import show

MOVED = ActionResult(
    task="slam", action=Action.MOVE, outcome=Outcome.FAILED, host="edge2", previous_host="edge1", located="edge1", downtime_s=1.5,
    phases=(PhaseResult(phase=Phase.STOP, host="edge1", seconds=0.25, ok=True), PhaseResult(phase=Phase.START, host="edge2", seconds=1.0, ok=False)),
    error="no space\x1b[2J left; restored on edge1",
    state=CarriedState(host="edge1", size_bytes=4_000_000, sent_bytes=1_000_000, sha256="ab" * 32, save_s=0.2, transfer_s=1.5, load_s=0.3, age_s=2.5),
)  # fmt: skip
PAST = [
    Revision(
        number=9,
        began_at=NOW,
        verb="apply",
        user="ada",
        ending=RevisionOutcome.PARTLY,
        seconds=2.5,
        counts={"move": 1},
        actions=(MOVED,),
    ),
    Revision(number=10, began_at=NOW + 60.0),
]
MEMORY = ManagerState(
    managed=True, placements={"slam": Placement(host="edge1", since=NOW - 900.0)}, cordons=frozenset({"edge2", "edge3"}),
    draining=frozenset({"edge3"}), contact={"edge1": NOW - 90.0},
)  # fmt: skip

SNAPSHOT = a_snapshot(edge1=silent(), edge2=a_sample(), edge3=a_sample(), memory=MEMORY)
FLEET = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"))


def test_history_is_one_line_per_revision() -> None:
    assert [line.split() for line in HistoryView(PAST).table().splitlines()] == [
        ["REVISION", "STARTED", "USER", "VERB", "TOOK", "OUTCOME", "ACTIONS"],
        ["9", "2025-11-21T01:53:20Z", "ada", "apply", "2.5s", "partly", "1", "move"],
        ["10", "2025-11-21T01:54:20Z", "-", "-", "-", "cut", "off", "-"],
    ]
    assert (HistoryView([]).table(), HistoryView([]).notes()) == ("", ["nothing was applied yet"])
    assert render_view(HistoryView(PAST), OutputFormat.NAME) == "revision/9\nrevision/10\n"


def test_a_revision_shows_its_phases_and_cannot_steer_the_terminal() -> None:
    text = RevisionView(PAST[0]).table()
    assert (
        "slam  failed  stop edge1 0.2s > start edge2 1.0s FAILED; gap 1.5s; no space\\x1b[2J left; restored on edge1"
        in text
    )
    assert render_view(RevisionView(PAST[0]), OutputFormat.NAME) == "task/slam\n"


def test_json_and_yaml_of_the_past_say_the_same() -> None:
    document = json.loads(render_view(RevisionView(PAST[0]), OutputFormat.JSON))
    assert yaml.safe_load(render_view(RevisionView(PAST[0]), OutputFormat.YAML)) == document
    assert yaml.safe_load(render_view(HistoryView(PAST), OutputFormat.YAML)) == json.loads(
        render_view(HistoryView(PAST), OutputFormat.JSON)
    )
    item = document["item"]
    assert (item["revision"], item["outcome"], item["duration_s"], item["placements"]) == (
        9,
        "partly",
        2.5,
        None,
    )
    assert [phase["duration_s"] for phase in item["actions"][0]["phases"]] == [0.25, 1]


def test_closed_hosts_show_everywhere() -> None:
    assert [line.split()[2:4] for line in SnapshotView(SNAPSHOT).table().splitlines()[2:4]] == [
        ["ok,", "cordoned"],
        ["ok,", "draining"],
    ]
    assert plan_sections.list_operator_mark_notes(SNAPSHOT) == [
        "cordoned, no new tasks: edge2 (edgectl uncordon)", "draining, tasks move away: edge3 (edgectl uncordon)",
    ]  # fmt: skip
    text = show(StatusView(SNAPSHOT, FLEET, some_tasks(a_task("slam"))))
    assert "note: cordoned, no new tasks: edge2 (edgectl uncordon)\n" in text


def test_a_silent_host_is_told_with_how_long() -> None:
    tasks = some_tasks(a_task("slam"), a_task("camera"))
    text = show(StatusView(SNAPSHOT, FLEET, tasks))
    assert "unknown (silent for 1m30s)" in text
    assert "\nedge1 does not answer: connection refused (silent for 1m30s)\n" in text
    rows = {row["task"]: row for row in StatusView(SNAPSHOT, FLEET, tasks).rows()}
    slam, camera = rows["slam"], rows["camera"]
    assert (slam["state"], slam["host"], slam["contacted_at"]) == (
        "unknown",
        "edge1",
        "2025-11-21T01:51:50Z",
    )
    assert slam["attention"] == "edge1 does not answer (silent for 1m30s)"
    assert (camera["state"], "host" in camera) == ("not running", False)


@pytest.mark.parametrize(("fenced", "code"), [(frozenset[str](), 4), (frozenset({"edge1"}), 0)])
def test_a_host_that_is_declared_off_need_not_answer(fenced: frozenset[str], code: int) -> None:
    snapshot = a_snapshot(edge1=silent(), memory=ManagerState(fenced=fenced))
    assert exit_codes.of_snapshot(snapshot, FLEET) == code
    assert plan_sections.list_operator_mark_notes(snapshot) == (
        ["fenced, treated as powered off: edge1 (edgectl unfence)"] if fenced else []
    )
