"""Every form of every value: harmless text, nothing cut, documents that parse."""

import dataclasses
import json
import re
from types import MappingProxyType

import pytest
import yaml

from edgectl.errors import UsageError
from edgectl.formats import plan as plan_format
from edgectl.formats import snapshot as snapshot_format
from edgectl.model.inventory import Role
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, Outcome, Phase, PhaseResult, Results
from edgectl.model.snapshot import BandwidthMeasurement, HostSample, HostStatus, TaskState
from edgectl.views import markdown, table
from edgectl.views.output_format import OutputFormat, get_renderer, list_output_formats
from edgectl.views.text import RenderOptions
from tests.views.fixtures import fleet, plan

FAILED = ActionResult(
    task="detection-robot1", action=Action.MOVE, outcome=Outcome.FAILED, host="edge2", previous_host="edge1", downtime_s=2.25,
    phases=(PhaseResult(phase=Phase.STOP, host="edge1", seconds=1.0, ok=True), PhaseResult(phase=Phase.READY, host="edge2", seconds=3.0, ok=False, detail="exit 1")),
    error="not ready", hint="edgectl logs detection-robot1", located="edge1",
)  # fmt: skip
RESULTS = Results(revision=7, actions=(FAILED,), seconds=4.0)
FIELDS = MappingProxyType({"edgectl": "1.0"})


def values(what: str) -> tuple[object, ...]:
    inventory, tasks, snapshot = fleet()
    return {
        "plan": (plan(),),
        "snapshot": (snapshot,),
        "status": (snapshot, inventory, tasks),
        "results": (RESULTS,),
        "validated": (inventory, tasks),
        "fields": (dict(FIELDS),),
    }[what]


CASES = [
    (form, what)
    for what in ("plan", "snapshot", "status", "results", "validated", "fields")
    for form in list_output_formats(what)
]


@pytest.mark.parametrize(("form", "what"), CASES)
def test_every_form_is_plain_complete_text(form: OutputFormat, what: str) -> None:
    text = get_renderer(form, what)(*values(what))
    assert text.endswith("\n")
    assert "\x1b" not in text
    assert "…" not in text
    assert not re.search(r"[ \t]+$", text, re.MULTILINE), "no blanks at the end of a line"


@pytest.mark.parametrize("what", ["plan", "snapshot", "status", "results", "validated", "fields"])
def test_json_and_yaml_are_the_same_document(what: str) -> None:
    document = json.loads(get_renderer(OutputFormat.JSON, what)(*values(what)))
    assert document["format_version"] == 1
    assert yaml.safe_load(get_renderer(OutputFormat.YAML, what)(*values(what))) == document


def test_documents_read_back() -> None:
    assert plan_format.decode(json.loads(get_renderer(OutputFormat.JSON, "plan")(plan()))) == plan()
    snapshot = fleet()[2]
    assert (
        snapshot_format.decode(json.loads(get_renderer(OutputFormat.JSON, "snapshot")(snapshot))) == snapshot
    )


def test_plan_table() -> None:
    text = table.plan(plan())
    lines = text.splitlines()
    assert lines[0].startswith(
        "Policy utility; weights cpu 0.25, memory 0.25, network 0.25, task 0.25; snapshot of 2026-"
    )
    assert re.match(r" +TASK +NOW +NEXT +UTILITY +LEAD +REASON$", lines[2])
    assert re.match(
        r"~ +detection-robot1 +edge1 +edge2 +0\.\d{3} +[+-]0\.\d{3} +move: edge1 short of cpu by", lines[3]
    )
    assert lines[-1] == "Plan: 0 to start, 1 to move, 0 to stop, 9 kept, 0 unplaced."


def test_wide_shows_four_terms_of_every_host_and_what_losers_lack() -> None:
    text = get_renderer(OutputFormat.WIDE, "plan")(plan())
    rows = [line for line in text.splitlines() if re.match(r" {3,}edge\d", line)]
    assert len(rows) == 20, "ten tasks, two losers each"
    assert any("short of cpu by" in row for row in rows)
    assert any("not the pinned host" in row for row in rows)
    assert re.search(r"CPU +MEMORY +NETWORK +TASK +TOTAL +REASON", text)


def test_no_changes_in_one_line() -> None:
    kept = tuple(step for step in plan().steps if step.action is Action.KEEP)
    text = table.plan(dataclasses.replace(plan(), steps=kept))
    assert text.splitlines()[-1] == "No changes. 9 tasks are where they should be."


def test_names_can_be_piped() -> None:
    assert get_renderer(OutputFormat.NAME, "plan")(plan()).splitlines()[0] == "task/detection-robot1"
    assert get_renderer(OutputFormat.NAME, "snapshot")(fleet()[2]).splitlines()[0] == "edge/edge1"


def test_markdown_carries_a_hidden_marker_and_one_row_per_task() -> None:
    text = markdown.plan(plan())
    assert text.startswith("<!-- edgectl-plan -->\n**Plan: ")
    assert len([line for line in text.splitlines() if line.startswith("| `")]) == 10


def test_a_host_cannot_steer_the_terminal() -> None:
    snapshot = fleet()[2]
    nasty = HostSample(role=Role.EDGE, status=HostStatus.UNREACHABLE, error="gone\x1b[2J\u202e\r\n<b>|x|`")
    sick = dataclasses.replace(snapshot, hosts={**snapshot.hosts, "edge3": nasty})
    inventory, tasks, _ = fleet()
    for form in (OutputFormat.TABLE, OutputFormat.WIDE, OutputFormat.NAME):
        assert get_renderer(form, "snapshot")(sick).isascii()
    assert table.status(sick, inventory, tasks).isascii()
    shown = dataclasses.replace(plan(), snapshot=sick)
    assert table.plan(shown).isascii()
    assert "\\|x\\|\\`" in markdown.plan(shown)


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
    rows = {
        line.split()[0]: line.split()[1:] for line in table.status(changed, inventory, tasks).splitlines()
    }
    assert rows["map-merge"][:2] == ["edge3", "unknown"]
    assert rows["detection-robot2"][:3] == ["-", "not", "running"]
    assert rows["slam-robot2"][:2] == ["-", "completed"]
    assert rows["note:"] == ["edge3", "does", "not", "answer:", "no", "route"]


def test_colour_never_carries_meaning_alone() -> None:
    coloured = table.plan(plan(), RenderOptions(colour=True))
    assert "\x1b[33m" in coloured
    assert re.sub(r"\x1b\[\d+m", "", coloured) == table.plan(plan())


@pytest.mark.parametrize("width", [80, 160])
def test_a_terminal_wraps_the_reason_under_itself(width: int) -> None:
    text = table.plan(plan(), RenderOptions(width=width))
    body = text.split("\n\n")[1]
    assert all(len(line) <= width for line in body.splitlines())
    assert "".join(body.split()) == "".join(table.plan(plan()).split("\n\n")[1].split()), "nothing is lost"


def test_results_name_the_phase_that_failed_and_the_hint() -> None:
    text = table.results(RESULTS)
    assert "stop edge1 1.0s > ready edge2 3.0s FAILED (exit 1); gap 2.2s; not ready" in text
    assert text.endswith("Applied 0 of 1 in 4.0s. Revision 7.\nhint: edgectl logs detection-robot1\n")


def test_a_drain_shows_every_pass_and_how_it_ended() -> None:
    good = Results(
        revision=8,
        actions=(dataclasses.replace(FAILED, outcome=Outcome.DONE, error="", hint=""),),
        seconds=1.0,
    )
    document = json.loads(
        get_renderer(OutputFormat.JSON, "drained")([RESULTS, good], [("slam", "edge1")], False)
    )
    assert (document["revision"], document["done"], document["left"]) == (
        8,
        False,
        [{"task": "slam", "host": "edge1"}],
    )
    assert [(each["revision"], each["done"]) for each in document["passes"]] == [(7, False), (8, True)]
    assert (
        yaml.safe_load(
            get_renderer(OutputFormat.YAML, "drained")([RESULTS, good], [("slam", "edge1")], False)
        )
        == document
    )
    text = get_renderer(OutputFormat.TABLE, "drained")([RESULTS, good], [], True)
    assert text == table.results(RESULTS) + "\n" + table.results(good)
    assert get_renderer(OutputFormat.NAME, "drained")([RESULTS, good], [], True) == "task/detection-robot1\n"


def test_what_links_carry_stands_in_every_form() -> None:
    snapshot = fleet()[2]
    links = (
        BandwidthMeasurement(edge="edge1", robot="robot1", bytes_per_s=12.5e6),
        BandwidthMeasurement(edge="edge2", robot="robot1", bytes_per_s=None, error="off"),
    )
    document = json.loads(get_renderer(OutputFormat.JSON, "bandwidth")(snapshot, links))
    assert document["bandwidth"] == [
        {"edge": "edge1", "robot": "robot1", "bytes_per_s": 12500000},
        {"edge": "edge2", "robot": "robot1", "error": "off"},
    ]
    assert snapshot_format.decode(document) == snapshot, "it is still a snapshot"
    assert yaml.safe_load(get_renderer(OutputFormat.YAML, "bandwidth")(snapshot, links)) == document
    for form, plain in (
        (OutputFormat.TABLE, get_renderer(OutputFormat.TABLE, "snapshot")),
        (OutputFormat.WIDE, get_renderer(OutputFormat.WIDE, "snapshot")),
    ):
        assert get_renderer(form, "bandwidth")(snapshot, links) == (
            "EDGE   ROBOT   CARRIED\nedge1  robot1  12.5MB/s\nedge2  robot1  off\n\n" + plain(snapshot)
        )
    assert get_renderer(OutputFormat.NAME, "bandwidth")(snapshot, links) == get_renderer(
        OutputFormat.NAME, "snapshot"
    )(snapshot)


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
        "status": table.status(sick, inventory, tasks, look),
        "plan": table.plan(plan(), look),
        "wide plan": get_renderer(OutputFormat.WIDE, "plan")(plan(), look),
        "probe": table.snapshot(sick, look),
        "wide probe": get_renderer(OutputFormat.WIDE, "snapshot")(sick, look),
        "results": table.results(RESULTS, look),
    }
    assert {
        what: line for what, text in shown.items() for line in text.splitlines() if len(line) > width
    } == {}
    assert shown["status"].splitlines()[0].split()[:3] == ["TASK", "HOST", "STATE"]


def test_a_status_on_a_narrow_terminal_has_the_demands_below() -> None:
    inventory, tasks, snapshot = fleet()
    lines = table.status(snapshot, inventory, tasks, RenderOptions(width=80)).splitlines()
    whole = table.status(snapshot, inventory, tasks).splitlines()
    assert lines[0].split() == ["TASK", "HOST", "STATE", "AGE", "CPU", "MEMORY", "NETWORK"]
    used, demanded = lines[1].split(), lines[2].split()
    assert demanded[0] == "demand"
    assert whole[1].split() == [*used[:5], demanded[1], used[5], demanded[2], used[6], demanded[3]]


def test_results_say_an_error_once() -> None:
    late = dataclasses.replace(FAILED.phases[1], detail=FAILED.error)
    shown = get_renderer(OutputFormat.TABLE, "results")(
        Results(
            revision=7, actions=(dataclasses.replace(FAILED, phases=(FAILED.phases[0], late)),), seconds=4.0
        )
    )
    assert shown.count("not ready") == 1


def test_a_form_that_does_not_exist_says_which_do() -> None:
    with pytest.raises(UsageError) as caught:
        get_renderer(OutputFormat.MARKDOWN, "status")
    assert caught.value.hint == "write -o table, json, yaml or name"


@pytest.mark.parametrize("width", [80, 160])
def test_names_as_long_as_they_get_fit_too(width: int) -> None:
    inventory, tasks, snapshot = fleet()
    long = "jetson-xavier-nx-of-the-laboratory-in-building-b2-rack-01"
    hosts = {long if name == "edge1" else name: host for name, host in snapshot.hosts.items()}
    renamed = dataclasses.replace(
        snapshot,
        hosts={
            name: dataclasses.replace(
                host, tasks={f"{task}-{long}"[:63]: run for task, run in host.tasks.items()}
            )
            for name, host in hosts.items()
        },
    )
    look = RenderOptions(width=width)
    shown = [
        table.status(renamed, inventory, tasks, look),
        table.snapshot(renamed, look),
        get_renderer(OutputFormat.WIDE, "snapshot")(renamed, look),
        get_renderer(OutputFormat.TABLE, "top_hosts")(renamed, inventory, (), look),
        get_renderer(OutputFormat.TABLE, "top_tasks")(renamed, inventory, tasks, (), look),
    ]
    assert [line for text in shown for line in text.splitlines() if len(line) > width] == []
