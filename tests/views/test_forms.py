# SPDX-License-Identifier: Apache-2.0
"""Every form of every value: harmless text, nothing cut, documents that parse."""

import csv
import dataclasses
import io
import json
import re
from types import MappingProxyType

import pytest
import yaml

from edgectl.errors import UsageError
from edgectl.formats.kinds import PLAN_KIND, SNAPSHOT_KIND
from edgectl.model.inventory import Role
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action
from edgectl.model.policy import Weights
from edgectl.model.result import ActionResult, Outcome, Phase, PhaseResult, Results
from edgectl.model.snapshot import BandwidthMeasurement, HostSample, HostStatus, TaskState
from edgectl.views import encoder
from edgectl.views.describe_host import HostDetailsView
from edgectl.views.describe_task import TaskDetailsView
from edgectl.views.listing import ListingView
from edgectl.views.listing_items import ListingKind, build_listing
from edgectl.views.output import ItemView, ListView, View, render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.plan import PlanView, escape_markdown
from edgectl.views.results import DrainView, ResultsView
from edgectl.views.snapshot import SnapshotView
from edgectl.views.status import StatusView
from edgectl.views.text import RenderOptions
from edgectl.views.top_hosts import TopHostsView
from edgectl.views.top_tasks import TopTasksView
from edgectl.views.validation import ValidationView, VersionView
from tests.views.fixtures import fleet, plan, show

FAILED = ActionResult(
    task="detection-robot1", action=Action.MOVE, outcome=Outcome.FAILED, host="edge2", previous_host="edge1", downtime_s=2.25,
    phases=(PhaseResult(phase=Phase.STOP, host="edge1", seconds=1.0, ok=True), PhaseResult(phase=Phase.READY, host="edge2", seconds=3.0, ok=False, detail="exit 1")),
    error="not ready", hint="edgectl logs detection-robot1", located="edge1",
)  # fmt: skip
RESULTS = Results(revision=7, actions=(FAILED,), seconds=4.0)
FIELDS = MappingProxyType({"edgectl": "1.0", "python": "3.11"})


def views() -> dict[str, View]:
    inventory, tasks, snapshot = fleet()
    step = plan().steps[0]
    return {
        "plan": PlanView(plan()),
        "snapshot": SnapshotView(snapshot),
        "status": StatusView(snapshot, inventory, tasks),
        "results": ResultsView(RESULTS),
        "nothing": ResultsView(None),
        "validation": ValidationView(inventory, tasks),
        "version": VersionView(dict(FIELDS)),
        "edges": ListingView(build_listing(ListingKind.EDGES, snapshot, inventory, tasks)),
        "links": ListingView(build_listing(ListingKind.LINKS, snapshot, inventory, tasks)),
        "tasks": ListingView(build_listing(ListingKind.TASKS, snapshot, inventory, tasks)),
        "top hosts": TopHostsView(snapshot, inventory, ()),
        "top tasks": TopTasksView(snapshot, inventory, tasks, ()),
        "host": HostDetailsView("edge1", snapshot, inventory, tasks, ()),
        "task": TaskDetailsView("slam-robot1", snapshot, inventory, tasks, step, ()),
    }


CASES = [
    (what, form)
    for what, view in views().items()
    for form in view.formats
    if form not in ("github", "gitlab")
]


@pytest.mark.parametrize(("what", "form"), CASES)
def test_every_form_is_plain_complete_text(what: str, form: OutputFormat) -> None:
    text = render_view(views()[what], form)
    assert text.endswith("\n") or (what, form) in {("nothing", "table"), ("nothing", "name")}
    assert "\x1b" not in text
    assert "…" not in text
    assert not re.search(r"[ \t]+$", text, re.MULTILINE), "no blanks at the end of a line"


@pytest.mark.parametrize("what", list(views()))
def test_all_documents_of_a_view_say_the_same(what: str) -> None:
    view = views()[what]
    document = json.loads(render_view(view, OutputFormat.JSON))
    assert yaml.safe_load(render_view(view, OutputFormat.YAML)) == document
    rows = [json.loads(line) for line in render_view(view, OutputFormat.JSONL).splitlines()]
    if isinstance(view, ListView):
        assert document["items"] == rows
        assert list(document) == ["format_version", "kind", "items", "warnings"]
    if isinstance(view, ItemView):
        assert [document["item"]] == rows
        assert list(document) == ["format_version", "kind", "item", "warnings"]
    found = list(csv.DictReader(io.StringIO(render_view(view, OutputFormat.CSV))))
    assert len(found) == len(rows)
    for flat, row in zip(found, rows, strict=True):
        assert {key: flat[key] for key, value in row.items() if isinstance(value, str)} == {
            key: value for key, value in row.items() if isinstance(value, str)
        }


def test_documents_read_back() -> None:
    assert PLAN_KIND.decode(json.loads(render_view(PlanView(plan()), OutputFormat.JSON))) == plan()
    snapshot = fleet()[2]
    assert (
        SNAPSHOT_KIND.decode(json.loads(render_view(SnapshotView(snapshot), OutputFormat.JSON))) == snapshot
    )


def test_plan_table() -> None:
    text = PlanView(plan()).table()
    lines = text.splitlines()
    assert lines[0] == "Fleet demo, weights all, snapshot of 2026-11-21T03:02:39Z"
    assert re.match(r" +TASK +NOW +NEXT +UTILITY +LEAD +REASON$", lines[2])
    assert re.match(
        r"~ +detection-robot1 +edge1 +edge2 +0\.\d{3} +[+-]0\.\d{3} +move: edge1 short of cpu by", lines[3]
    )
    assert lines[4:6] == ["=  9 kept (-o wide shows all)", ""]
    assert lines[-1] == "Plan: 0 to start, 1 to move, 0 to stop, 9 kept, 0 unplaced."
    seen = dataclasses.replace(plan().policy, weights=Weights(cpu=1, memory=1, network=0, task=0))
    live = PlanView(dataclasses.replace(plan(), policy=seen, fleet="lab"), now=plan().created_at + 2)
    assert (
        live.table().splitlines()[0]
        == "Fleet lab, weights cpu 1 memory 1 network 0 task 0, snapshot 2.0s ago"
    )


def test_a_plan_without_expected_load_names_its_fleet_on_a_terminal_too() -> None:
    """No host answers, or the actions were asked for: weights and age would say nothing."""
    asked = dataclasses.replace(plan(), expected={})
    assert PlanView(asked).table(RenderOptions(width=80)).startswith("Fleet demo\n\n ")
    assert PlanView(asked).table().startswith(" ")


def test_wide_shows_four_terms_of_every_host_and_what_losers_lack() -> None:
    text = render_view(PlanView(plan()), OutputFormat.WIDE)
    rows = [line for line in text.splitlines() if re.match(r" {3,}edge\d", line)]
    assert len(rows) == 20, "ten tasks, two losers each"
    assert any("short of cpu by" in row for row in rows)
    assert any("not the pinned host" in row for row in rows)
    assert re.search(r"CPU +MEMORY +NETWORK +AFFINITY +UTILITY +REASON", text)


def test_no_changes_in_one_line() -> None:
    kept = tuple(step for step in plan().steps if step.action is Action.KEEP)
    text = PlanView(dataclasses.replace(plan(), steps=kept)).table()
    assert text.splitlines()[-1] == "No changes. 9 tasks are where they should be."


def test_names_can_be_piped() -> None:
    assert render_view(PlanView(plan()), OutputFormat.NAME).splitlines()[0] == "task/detection-robot1"
    assert render_view(SnapshotView(fleet()[2]), OutputFormat.NAME).splitlines()[0] == "edge/edge1"


def test_markdown_carries_a_hidden_marker_and_one_row_per_task() -> None:
    text = render_view(PlanView(plan()), OutputFormat.MARKDOWN)
    assert text.startswith("<!-- edgectl-plan -->\n**Plan: ")
    assert len([line for line in text.splitlines() if line.startswith("| `")]) == 10


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("@org/team", "@&#8203;org/team"),
        ("a@b.example", "a@&#8203;b.example"),
        ("http://evil.example/x", "http:&#8203;//evil.example/x"),
        ("HTTPS://e.example", "HTTPS:&#8203;//e.example"),
        ("www.evil.example", "www&#8203;.evil.example"),
        ("mailto:a", "mailto:&#8203;a"),
        ("&commat;team &#64;team", "\\&commat;team \\&\\#64;team"),
        ("12:30 slam-robot1", "12:30 slam-robot1"),
    ],
)
def test_markdown_has_no_live_mention_and_no_link(text: str, shown: str) -> None:
    assert escape_markdown(text) == shown


def test_a_host_cannot_steer_the_terminal() -> None:
    snapshot = fleet()[2]
    nasty = HostSample(role=Role.EDGE, status=HostStatus.UNREACHABLE, error="gone\x1b[2J\u202e\r\n<b>|x|`")
    sick = dataclasses.replace(snapshot, hosts={**snapshot.hosts, "edge3": nasty})
    inventory, tasks, _ = fleet()
    for form in (OutputFormat.TABLE, OutputFormat.WIDE, OutputFormat.NAME):
        assert render_view(SnapshotView(sick), form).isascii()
    assert StatusView(sick, inventory, tasks).table().isascii()
    shown = dataclasses.replace(plan(), snapshot=sick)
    assert PlanView(shown).table().isascii()
    assert "\\|x\\|\\`" in render_view(PlanView(shown), OutputFormat.MARKDOWN)


def test_status_tells_silence_from_absence() -> None:
    inventory, tasks, snapshot = fleet()
    memory = snapshot.manager or ManagerState()
    gone = HostSample(role=Role.EDGE, status=HostStatus.UNREACHABLE, error="no route")
    done = {"slam-robot2": tasks.tasks["slam-robot2"].spec_hash}
    without = dataclasses.replace(snapshot.hosts["edge2"], tasks={})
    changed = dataclasses.replace(
        snapshot,
        hosts={**snapshot.hosts, "edge3": gone, "edge2": without},
        manager=dataclasses.replace(memory, done=done),
    )
    text = show(StatusView(changed, inventory, tasks))
    rows = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line}
    assert rows["map-merge"][:2] == ["edge3", "unknown"]
    assert rows["detection-robot2"][:3] == ["-", "not", "running"]
    assert rows["slam-robot2"][:2] == ["-", "completed"]
    assert text.splitlines()[1] == "edge3 does not answer: no route"


def test_colour_never_carries_meaning_alone() -> None:
    coloured = PlanView(plan()).table(RenderOptions(colour=True))
    assert "\x1b[33m" in coloured
    assert re.sub(r"\x1b\[\d+m", "", coloured) == PlanView(plan()).table()


@pytest.mark.parametrize("width", [80, 160])
def test_a_terminal_wraps_the_reason_under_itself(width: int) -> None:
    text = PlanView(plan()).table(RenderOptions(width=width))
    body = text.split("\n\n")[1]
    assert all(len(line) <= width for line in body.splitlines())
    assert "".join(body.split()) == "".join(PlanView(plan()).table().split("\n\n")[1].split()), (
        "nothing is lost"
    )


def test_results_name_the_phase_that_failed_and_the_hint() -> None:
    text = ResultsView(RESULTS).table()
    assert "stop edge1 1.0s > ready edge2 3.0s FAILED (exit 1); gap 2.2s; not ready" in text
    assert text.endswith("Applied 0 of 1 in 4.0s. Revision 7.\nhint: edgectl logs detection-robot1\n")


def test_a_drain_shows_every_pass_and_the_rest() -> None:
    good = Results(
        revision=8,
        actions=(dataclasses.replace(FAILED, outcome=Outcome.DONE, error="", hint=""),),
        seconds=1.0,
    )
    view = DrainView([RESULTS, good], [("slam", "edge1")], done=False)
    item = json.loads(render_view(view, OutputFormat.JSON))["item"]
    assert (item["done"], item["left"]) == (False, [{"task": "slam", "host": "edge1"}])
    assert [(each["revision"], each["done"]) for each in item["passes"]] == [(7, False), (8, True)]
    assert view.table() == ResultsView(RESULTS).table() + "\n" + ResultsView(good).table()
    assert render_view(view, OutputFormat.NAME) == "task/detection-robot1\n"


def test_bandwidth_stands_in_every_form() -> None:
    snapshot = fleet()[2]
    links = (
        BandwidthMeasurement(edge="edge1", robot="robot1", bytes_per_s=12.5e6),
        BandwidthMeasurement(edge="edge2", robot="robot1", bytes_per_s=None, error="off"),
    )
    view, plain = SnapshotView(snapshot, links), SnapshotView(snapshot)
    document = json.loads(render_view(view, OutputFormat.JSON))
    assert document["bandwidth"] == [
        {"edge": "edge1", "robot": "robot1", "capacity_bytes_per_s": 12500000},
        {"edge": "edge2", "robot": "robot1", "error": "off"},
    ]
    assert SNAPSHOT_KIND.decode(document) == snapshot, "it is still a snapshot"
    table = "EDGE   ROBOT   CAPACITY\nedge1  robot1  12.5MB/s\nedge2  robot1  off\n\n"
    assert view.table() == table + plain.table()
    assert view.wide() == table + plain.wide()
    assert view.names() == plain.names()


@pytest.mark.parametrize("width", [80, 160])
def test_no_table_passes_the_edge_of_the_terminal(width: int) -> None:
    inventory, tasks, snapshot = fleet()
    edge1 = snapshot.hosts["edge1"]
    broken = dataclasses.replace(
        next(iter(edge1.tasks.values())), state=TaskState.CRASHLOOP, restarts=5, last_exit=1
    )
    sick = dataclasses.replace(
        snapshot,
        hosts={**snapshot.hosts, "edge1": dataclasses.replace(edge1, tasks={"detection-robot1": broken})},
    )
    look = RenderOptions(width=width)
    shown = {
        "status": StatusView(sick, inventory, tasks).table(look),
        "plan": PlanView(plan()).table(look),
        "wide plan": render_view(PlanView(plan()), OutputFormat.WIDE, look),
        "probe": SnapshotView(sick).table(look),
        "wide probe": render_view(SnapshotView(sick), OutputFormat.WIDE, look),
        "results": ResultsView(RESULTS).table(look),
    }
    assert {
        what: line for what, text in shown.items() for line in text.splitlines() if len(line) > width
    } == {}
    header, first, _, head = shown["status"].splitlines()[:4]
    assert header == "Fleet demo, 7/10 tasks run, 6/6 hosts answer, 1 problem:"
    assert first == "1 of 10 tasks failed: detection-robot1 on edge1"
    assert head.split()[:3] == ["TASK", "HOST", "STATE"]


def test_a_status_on_a_narrow_terminal_has_the_demands_below() -> None:
    inventory, tasks, snapshot = fleet()
    lines = StatusView(snapshot, inventory, tasks).table(RenderOptions(width=80)).splitlines()[2:]
    whole = StatusView(snapshot, inventory, tasks).table().splitlines()[2:]
    assert lines[0].split() == ["TASK", "HOST", "STATE", "AGE", "CPU", "MEMORY", "NETWORK"]
    used, demanded = lines[1].split(), lines[2].split()
    assert demanded[0] == "demand"
    assert whole[1].split() == [*used[:5], demanded[1], used[5], demanded[2], used[6], demanded[3]]


def test_results_say_an_error_once() -> None:
    late = dataclasses.replace(FAILED.phases[1], detail=FAILED.error)
    shown = render_view(
        ResultsView(
            Results(
                revision=7,
                actions=(dataclasses.replace(FAILED, phases=(FAILED.phases[0], late)),),
                seconds=4.0,
            )
        ),
        OutputFormat.TABLE,
    )
    assert shown.count("not ready") == 1


def test_an_unsupported_form_names_those_that_are() -> None:
    inventory, tasks, snapshot = fleet()
    with pytest.raises(UsageError) as caught:
        render_view(StatusView(snapshot, inventory, tasks), OutputFormat.MARKDOWN)
    assert caught.value.message == 'output format "markdown" is not supported here'
    assert caught.value.hint == "use -o table, wide, json, jsonl, yaml, csv or name"


def test_numbers_are_rounded_at_the_encoder() -> None:
    given = {"a": 1.23456789, "b": -0.0, "c": 4.0, "d": [2e-7 / 3, 123456789.5], "e": 16598306817, "f": True}
    assert encoder.round_numbers(given) == {
        "a": 1.23457, "b": 0, "c": 4, "d": [6.66667e-08, 123457000], "e": 16598306817, "f": True,
    }  # fmt: skip
    assert str(encoder.round_numbers(-0.0)) == "0"
    assert encoder.round_numbers(given)["f"] is True  # type: ignore[index]


def test_csv_joins_the_keys_of_objects() -> None:
    rows: list[dict[str, object]] = [
        {"task": "a", "memory": {"used_bytes": 2}, "names": ["x"]},
        {"task": 'b,"', "pid": None},
    ]
    assert encoder.encode_csv(rows) == 'task,memory_used_bytes,names,pid\na,2,"[""x""]",\n"b,""",,,\n'
    assert encoder.encode_csv([]) == ""


def test_long_names_are_never_split() -> None:
    inventory, tasks, snapshot = fleet()
    long = "jetson-xavier-nx-of-the-laboratory-in-building-b2-rack-01"
    hosts = {long if name == "edge1" else name: host for name, host in snapshot.hosts.items()}
    renamed = dataclasses.replace(snapshot, hosts=hosts)
    look = RenderOptions(width=80)
    for text in (
        StatusView(renamed, inventory, tasks).table(look),
        SnapshotView(renamed).wide(look),
        TopHostsView(renamed, inventory, ()).table(look),
        TopTasksView(renamed, inventory, tasks, ()).table(look),
    ):
        assert long in text


def test_headings_are_bold_where_colour_is_allowed() -> None:
    inventory, tasks, snapshot = fleet()
    look = RenderOptions(colour=True)
    for text in (StatusView(snapshot, inventory, tasks).table(look), SnapshotView(snapshot).table(look)):
        assert text.startswith("\x1b[1m")
