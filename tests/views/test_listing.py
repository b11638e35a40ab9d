# SPDX-License-Identifier: Apache-2.0
"""get: what is listed, and what counts as a change."""

import json
from dataclasses import replace
from typing import Any

import pytest
import yaml

from edgectl.model.inventory import Connection
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import CapacitySource, LinkSample, Snapshot, TaskState
from edgectl.views.listing import ListingChangesView, ListingView
from edgectl.views.listing_items import (
    ItemChange,
    Listing,
    ListingKind,
    build_listing,
    compare_listings,
)
from edgectl.views.output_format import OutputFormat
from edgectl.views.text import RenderOptions
from tests.builders import (
    GI,
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
from tests.views.fixtures import show

LINK = LinkSample(
    capacity_bytes_per_s=10e6, used_bytes_per_s=1e6, rtt_ms=2.25, capacity_source=CapacitySource.ASSUMED
)
FLEET = an_inventory(
    an_edge("edge1", labels={"gpu": "maxwell", "room": "b2"}), an_edge("edge2"), a_robot("robot1", onboard=True), a_robot("robot2", probe=False),
    an_edge("a-name-as-long-as-names-of-edges-in-a-real-lab-tend-to-be", connection=Connection.OPENSSH),
)  # fmt: skip
TASKS = some_tasks(
    a_task("slam", robots=["robot1"]),
    a_task("nav", robots=["robot1"], needs=["slam"]),
    a_task("camera"),
    a_task("late"),
)
MEMORY = ManagerState(
    cordons=frozenset({"edge1"}), placements={"late": Placement(host="edge2", since=NOW - 900)}, contact={"edge2": NOW - 90},
    done={"camera": "hash-camera"},
)  # fmt: skip


def snapshot(**fields: Any) -> Snapshot:
    runs = {
        "slam": a_run(started_at=NOW - 192, metrics={"fps": 29.97, "loss": 0.03125}),
        "nav": a_run(TaskState.CRASHLOOP, pid=0, restarts=5, last_exit=1),
        "old": a_run(),
    }
    edge1 = a_sample(used=1.0, used_memory=GI, tasks=runs, links={"robot1": LINK})
    return a_snapshot(
        edge1=replace(edge1, **fields), edge2=silent(), robot1=a_sample(cores=2.0), memory=MEMORY
    )


def listed(kind: ListingKind, value: Snapshot | None = None) -> Listing:
    return build_listing(kind, value or snapshot(), FLEET, TASKS)


def listing_view(kind: ListingKind) -> ListingView:
    return ListingView(listed(kind))


def shown(
    kind: ListingKind, form: OutputFormat = OutputFormat.TABLE, look: RenderOptions | None = None
) -> str:
    return show(listing_view(kind), form, look or RenderOptions())


LONG = "a-name-as-long-as-names-of-edges-in-a-real-lab-tend-to-be"


def test_edges() -> None:
    room = " " * (len(LONG) - len("HOST"))
    assert shown(ListingKind.EDGES).splitlines() == [
        f"HOST {room} STATUS        CORES  MEMORY  TASKS  LABELS",
        f"{LONG}  not probed        -       -      -  -",
        f"edge1{room} ok, cordoned   4.00   4.0Gi      2  gpu=maxwell,room=b2",
        f"edge2{room} unreachable       -       -      -  -",
        "note: edge2 does not answer: connection refused (silent for 1m30s)",
    ]


def test_robots() -> None:
    assert shown(ListingKind.ROBOTS) == (
        "HOST    STATUS      CORES  MEMORY  TASKS  ONBOARD  LABELS\n"
        "robot1  ok           2.00   4.0Gi      0  yes      -\n"
        "robot2  not probed      -       -      -  no       -\n"
        "note: edge2 does not answer: connection refused (silent for 1m30s)\n"
    )


def test_tasks_stand_in_the_order_of_the_files_then_the_others() -> None:
    assert shown(ListingKind.TASKS) == (
        "TASK    HOST   STATE                             RESTARTS    AGE\n"
        "camera  -      completed                                -      -\n"
        "late    edge2  unknown (silent for 1m30s)               -      -\n"
        "nav     edge1  failed (5 restarts, last exit 1)         5      -\n"
        "slam    edge1  ready                                    0  3m12s\n"
        "old     edge1  ready                                    0  1h00m\n"
        "note: edge2 does not answer: connection refused (silent for 1m30s)\n"
    )


def test_nothing_is_said_to_be_nothing() -> None:
    empty = replace(listed(ListingKind.LINKS), items=(), notes=())
    assert show(ListingView(empty), OutputFormat.TABLE, RenderOptions()) == "note: no links\n"


def test_links() -> None:
    rows = [line.split() for line in shown(ListingKind.LINKS, OutputFormat.WIDE).splitlines()]
    assert rows[0] == ["EDGE", "ROBOT", "CAPACITY", "SOURCE", "NOMINAL", "NETWORK", "RTT", "AGE"]
    assert rows[3] == ["edge1", "robot1", "10.0MB/s", "assumed", "10.0MB/s", "1.0MB/s", "2.2ms", "-"]
    assert rows[4] == ["edge1", "robot2", "-", "unknown", "-", "-", "-", "-"]


def test_wide_of_edges_and_tasks() -> None:
    assert shown(ListingKind.EDGES, OutputFormat.WIDE).splitlines()[2].split()[6:] == [
        "ssh",
        "edge1.lab",
        "25%",
        "25%",
        "gpu=maxwell,room=b2",
    ]
    assert [line.split()[-6:] for line in shown(ListingKind.TASKS, OutputFormat.WIDE).splitlines()[4:-1]] == [
        ["4242", "fps", "29.97,", "loss", "0.03125", "3m12s"],
        ["files", "-", "-", "4242", "-", "1h00m"],
    ]


def letters(text: str) -> list[str]:
    """What must not be lost, wherever it stands; a dash that has no room below its row may be."""
    return sorted("".join(text.split()).replace("-", ""))


@pytest.mark.parametrize("kind", list(ListingKind))
@pytest.mark.parametrize("width", [80, 160])
@pytest.mark.parametrize("form", [OutputFormat.TABLE, OutputFormat.WIDE])
def test_no_listing_passes_the_edge(kind: ListingKind, width: int, form: OutputFormat) -> None:
    text = shown(kind, form, RenderOptions(width=width))
    lines = [line for line in text.splitlines() if LONG not in text]
    assert max(map(len, lines), default=0) <= width
    assert (LONG in text) == (LONG in shown(kind, form)), "no name is split"
    assert letters(text) == letters(shown(kind, form)), "nothing is cut"


@pytest.mark.parametrize("kind", list(ListingKind))
def test_documents(kind: ListingKind) -> None:
    document = json.loads(shown(kind, OutputFormat.JSON))
    assert (document["format_version"], document["kind"]) == (2, kind.removesuffix("s"))
    assert {item["taken_at"] for item in document["items"]} == {"2025-11-21T01:53:20Z"}
    assert yaml.safe_load(shown(kind, OutputFormat.YAML)) == document
    first = "edge" if kind is ListingKind.HOSTS else kind.removesuffix("s")
    assert shown(kind, OutputFormat.NAME).splitlines()[0].startswith(first + "/")


def test_a_document_has_declarations_and_measurements() -> None:
    edge1 = json.loads(shown(ListingKind.EDGES, OutputFormat.JSON))["items"][1]
    assert (edge1["host"], edge1["address"], edge1["mark"], edge1["cpu"]) == (
        "edge1",
        "edge1.lab",
        "cordoned",
        {"used_cores": 1, "capacity_cores": 4},
    )
    late = json.loads(shown(ListingKind.TASKS, OutputFormat.JSON))["items"][1]
    assert (late["task"], late["state"], late["host"], late["contacted_at"]) == (
        "late",
        "unknown",
        "edge2",
        "2025-11-21T01:51:50Z",
    )


def test_what_is_only_measured_is_no_change() -> None:
    before = listed(ListingKind.EDGES)
    busy = a_sample(used=3.0, used_memory=2 * GI, tasks=snapshot().hosts["edge1"].tasks, age=1.0)
    after = replace(snapshot(), taken_at=NOW + 5, hosts={**snapshot().hosts, "edge1": busy})
    assert compare_listings(before, listed(ListingKind.EDGES, after)) == []
    assert (
        compare_listings(
            listed(ListingKind.TASKS), listed(ListingKind.TASKS, replace(snapshot(), taken_at=NOW + 5))
        )
        == []
    )
    live = replace(LINK, nominal=20e6, capacity_source=CapacitySource.TCP, capacity_age_s=1.0)
    later = replace(live, capacity_bytes_per_s=3e6, capacity_source=CapacitySource.PROBE, capacity_age_s=0.0)
    for link, then in ((replace(LINK, used_bytes_per_s=5e6, rtt_ms=9.0), LINK), (later, live)):
        listings = (listed(ListingKind.LINKS, snapshot(links={"robot1": each})) for each in (then, link))
        assert compare_listings(*listings) == []


def test_the_first_look_adds_everything() -> None:
    assert [change for change, _ in compare_listings(None, listed(ListingKind.TASKS))] == [
        ItemChange.ADDED
    ] * 5


def test_changes_are_told_once() -> None:
    first = listed(ListingKind.TASKS)
    after = listed(
        ListingKind.TASKS,
        snapshot(tasks={"slam": a_run(TaskState.FAILED, detail="exited with 3"), "nav": a_run()}),
    )
    found = [(change.value, item.path) for change, item in compare_listings(first, after)]
    assert found == [("MODIFIED", "nav on edge1"), ("MODIFIED", "slam on edge1"), ("DELETED", "old on edge1")]
    text = show(ListingChangesView(after, compare_listings(first, after), first), OutputFormat.TABLE)
    assert text == (
        "nav     edge1  ready                                    0  1h00m\n"
        "slam    edge1  failed (exited with 3)                   0      -\n"
        "old     edge1  gone                                     0  1h00m\n"
    )
    lines = [
        json.loads(line)
        for line in show(
            ListingChangesView(after, compare_listings(first, after), first), OutputFormat.JSONL
        ).splitlines()
    ]
    assert [(line["type"], line["object"]["task"]) for line in lines] == [
        ("MODIFIED", "nav"),
        ("MODIFIED", "slam"),
        ("DELETED", "old"),
    ]
    assert lines[0]["at"] == "2025-11-21T01:53:20Z"
    assert compare_listings(after, after) == []


def test_the_first_of_the_lines_is_the_whole_table() -> None:
    first = listed(ListingKind.EDGES)
    for form in (OutputFormat.TABLE, OutputFormat.WIDE):
        assert show(ListingChangesView(first, compare_listings(None, first), None), form) == shown(
            ListingKind.EDGES, form
        )
    assert show(ListingChangesView(first, compare_listings(None, first), None), OutputFormat.NAME) == shown(
        ListingKind.EDGES, OutputFormat.NAME
    )
