"""get: what is listed, and what counts as a change."""

import json
from dataclasses import replace

import pytest
import yaml

from edgectl.model.inventory import Connection
from edgectl.model.memory import Memory, Placement
from edgectl.model.snapshot import CapacitySource, LinkSample, Snapshot, TaskState
from edgectl.views.form import Form, view
from edgectl.views.listing import Change, Kind, Listing, changes, listing
from edgectl.views.text import Look
from tests.builders import GI, NOW, a_robot, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, silent, some_tasks

LINK = LinkSample(capacity_bytes_per_s=10e6, used_bytes_per_s=1e6, rtt_ms=2.25, capacity_source=CapacitySource.ASSUMED)
FLEET = an_inventory(
    an_edge("edge1", labels={"gpu": "maxwell", "room": "b2"}), an_edge("edge2"), a_robot("robot1", onboard=True), a_robot("robot2", probe=False),
    an_edge("a-name-as-long-as-names-of-edges-in-a-real-lab-tend-to-be", connection=Connection.OPENSSH),
)  # fmt: skip
TASKS = some_tasks(a_task("slam", robots=["robot1"]), a_task("nav", robots=["robot1"], needs=["slam"]), a_task("camera"), a_task("late"))
MEMORY = Memory(
    cordons=frozenset({"edge1"}), placements={"late": Placement(host="edge2", since=NOW - 900)}, contact={"edge2": NOW - 90},
    done={"camera": "hash-camera"},
)  # fmt: skip


def snapshot(**fields: object) -> Snapshot:
    runs = {
        "slam": a_run(started_at=NOW - 192, metrics={"fps": 29.97, "loss": 0.03125}),
        "nav": a_run(TaskState.CRASHLOOP, pid=0, restarts=5, last_exit=1),
        "old": a_run(),
    }
    edge1 = a_sample(used=1.0, used_memory=GI, tasks=runs, links={"robot1": LINK})
    return a_snapshot(edge1=replace(edge1, **fields), edge2=silent(), robot1=a_sample(cores=2.0), memory=MEMORY)


def listed(kind: Kind, value: Snapshot | None = None) -> Listing:
    return listing(kind, value or snapshot(), FLEET, TASKS)


def shown(kind: Kind, form: Form = Form.TABLE, look: Look | None = None) -> str:
    return view(form, "listing")(listed(kind), look or Look())


LONG = "a-name-as-long-as-names-of-edges-in-a-real-lab-tend-to-be"


def test_edges() -> None:
    assert shown(Kind.EDGES).splitlines() == [
        "NAME                                                       STATUS        CORES  MEMORY  TASKS  LABELS",
        f"{LONG}  not probed    -      -       -      -",
        "edge1                                                      ok, cordoned  4.00   4.0Gi   2      gpu=maxwell,room=b2",
        "edge2                                                      unreachable   -      -       -      -",
        "note: edge2 does not answer: connection refused (silent for 1m30s)",
    ]


def test_robots() -> None:
    assert shown(Kind.ROBOTS) == (
        "NAME    STATUS      CORES  MEMORY  TASKS  ONBOARD  LABELS\n"
        "robot1  ok          2.00   4.0Gi   0      yes      -\n"
        "robot2  not probed  -      -       -      no       -\n"
        "note: edge2 does not answer: connection refused (silent for 1m30s)\n"
    )


def test_tasks_stand_in_the_order_of_the_files_then_the_others() -> None:
    assert shown(Kind.TASKS) == (
        "NAME    HOST   STATE                             RESTARTS  UP\n"
        "camera  -      completed                         -         -\n"
        "late    edge2  unknown (silent for 1m30s)        -         -\n"
        "nav     edge1  failed (5 restarts, last exit 1)  5         -\n"
        "slam    edge1  ready                             0         3m12s\n"
        "old     edge1  ready                             0         1h00m\n"
        "note: edge2 does not answer: connection refused (silent for 1m30s)\n"
    )


def test_nothing_is_said_to_be_nothing() -> None:
    empty = replace(listed(Kind.LINKS), items=(), notes=())
    assert view(Form.TABLE, "listing")(empty, Look()) == "No links.\n"


def test_links() -> None:
    rows = [line.split() for line in shown(Kind.LINKS, Form.WIDE).splitlines()]
    assert rows[0] == ["EDGE", "ROBOT", "CAPACITY", "USED", "RTT", "SOURCE"]
    assert rows[3] == ["edge1", "robot1", "10.0MB/s", "1.0MB/s", "2.2ms", "assumed"]
    assert rows[4] == ["edge1", "robot2", "-", "-", "-", "unknown"]


def test_wide_of_edges_and_tasks() -> None:
    assert shown(Kind.EDGES, Form.WIDE).splitlines()[2].split()[6:] == ["ssh", "edge1.lab", "25%", "25%", "gpu=maxwell,room=b2"]
    assert [line.split()[-6:] for line in shown(Kind.TASKS, Form.WIDE).splitlines()[4:-1]] == [
        ["4242", "fps", "29.97,", "loss", "0.03125", "3m12s"],
        ["files", "-", "-", "4242", "-", "1h00m"],
    ]


def letters(text: str) -> list[str]:
    """What must not be lost, wherever it stands; a dash that has no room below its row may be."""
    return sorted("".join(text.split()).replace("-", ""))


@pytest.mark.parametrize("kind", list(Kind))
@pytest.mark.parametrize("width", [80, 160])
@pytest.mark.parametrize("form", [Form.TABLE, Form.WIDE])
def test_no_listing_passes_the_edge(kind: Kind, width: int, form: Form) -> None:
    text = shown(kind, form, Look(width=width))
    assert max(map(len, text.splitlines())) <= width
    assert letters(text) == letters(shown(kind, form)), "nothing is cut"


@pytest.mark.parametrize("kind", list(Kind))
def test_documents(kind: Kind) -> None:
    document = json.loads(shown(kind, Form.JSON))
    assert (document["format_version"], document["taken_at"]) == (1, "2025-11-21T01:53:20Z")
    assert {item["kind"] for item in document["items"]} == {kind.removesuffix("s")}
    assert yaml.safe_load(shown(kind, Form.YAML)) == document
    assert shown(kind, Form.NAME).splitlines()[0] == f"{kind.removesuffix('s')}/{document['items'][0]['name']}"


def test_a_document_says_what_is_stated_and_what_is_measured() -> None:
    edge1 = json.loads(shown(Kind.EDGES, Form.JSON))["items"][1]
    assert (edge1["name"], edge1["address"], edge1["closed"], edge1["cpu"]) == (
        "edge1",
        "edge1.lab",
        "cordoned",
        {"cores": 4, "used_cores": 1},
    )
    late = json.loads(shown(Kind.TASKS, Form.JSON))["items"][1]
    assert late == {"kind": "task", "name": "late", "state": "unknown", "last_host": "edge2", "last_contact": "2025-11-21T01:51:50Z"}


def test_what_is_only_measured_is_no_change() -> None:
    before = listed(Kind.EDGES)
    busy = a_sample(used=3.0, used_memory=2 * GI, tasks=snapshot().hosts["edge1"].tasks, age=1.0)
    after = replace(snapshot(), taken_at=NOW + 5, hosts={**snapshot().hosts, "edge1": busy})
    assert changes(before, listed(Kind.EDGES, after)) == []
    assert changes(listed(Kind.TASKS), listed(Kind.TASKS, replace(snapshot(), taken_at=NOW + 5))) == []
    link = replace(LINK, used_bytes_per_s=5e6, rtt_ms=9.0)
    assert changes(listed(Kind.LINKS), listed(Kind.LINKS, snapshot(links={"robot1": link}))) == []


def test_the_first_look_adds_everything() -> None:
    assert [change for change, _ in changes(None, listed(Kind.TASKS))] == [Change.ADDED] * 5


def test_changes_are_told_once() -> None:
    first = listed(Kind.TASKS)
    after = listed(Kind.TASKS, snapshot(tasks={"slam": a_run(TaskState.FAILED, detail="exited with 3"), "nav": a_run()}))
    found = [(change.value, item.path) for change, item in changes(first, after)]
    assert found == [("MODIFIED", "nav on edge1"), ("MODIFIED", "slam on edge1"), ("DELETED", "old on edge1")]
    text = view(Form.TABLE, "listing_more")(after, changes(first, after), first)
    assert text == (
        "nav     edge1  ready                             0         1h00m\n"
        "slam    edge1  failed (exited with 3)            0         -\n"
        "old     edge1  gone                              0         1h00m\n"
    )
    lines = [json.loads(line) for line in view(Form.JSON, "listing_more")(after, changes(first, after), first).splitlines()]
    assert [(line["type"], line["object"]["name"]) for line in lines] == [("MODIFIED", "nav"), ("MODIFIED", "slam"), ("DELETED", "old")]
    assert lines[0]["at"] == "2025-11-21T01:53:20Z"
    assert changes(after, after) == []


def test_the_first_of_the_lines_is_the_whole_table() -> None:
    first = listed(Kind.EDGES)
    for form in (Form.TABLE, Form.WIDE):
        assert view(form, "listing_more")(first, changes(None, first), None) == shown(Kind.EDGES, form)
    assert view(Form.NAME, "listing_more")(first, changes(None, first), None) == shown(Kind.EDGES, Form.NAME)
