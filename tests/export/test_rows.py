# SPDX-License-Identifier: Apache-2.0
"""Rows that the csv module and any JSON reader read back unchanged."""

import csv
import dataclasses
import io
import json
import re
from pathlib import Path

import pytest

from edgectl.export.history_rows import COLUMNS, RowKind, format_csv_lines, format_json_lines
from edgectl.model.event import Event, EventKind
from edgectl.model.point import (
    HOST_AMOUNT_COLUMNS,
    HandoffPoint,
    HistoryPoint,
    HostPoint,
    LinkPoint,
    MetricPoint,
    TaskPoint,
)
from edgectl.model.resource import Usage
from edgectl.model.result import Outcome
from edgectl.model.snapshot import HostStatus, TaskState
from edgectl.model.text import escape_unprintable
from tests.builders import NOW

AWKWARD = 'it said: "a,b"; and\nthen, =1+1\r\n  ümläut \u2028'
POINTS: dict[RowKind, HistoryPoint] = {
    RowKind.HOSTS: HostPoint(at=NOW + 0.25, host="edge1", status=HostStatus.UNREACHABLE),
    RowKind.LINKS: LinkPoint(at=NOW, edge="edge1", robot="robot1", capacity_bytes_per_s=6.75e6, used_bytes_per_s=12.5),
    RowKind.TASKS: TaskPoint(
        at=NOW, task="slam", host="edge1", state=TaskState.READY, used=Usage(cpu=0.1, memory=2e8), instance="i-1",
        spec_hash="h-1", age_s=12.0, links=2,
    ),
    RowKind.METRICS: MetricPoint(at=NOW, task="slam", host="edge1", name="map/loss", value=-1e-7, instance="i-1"),
    RowKind.HANDOFFS: HandoffPoint(
        at=NOW, task="slam", host="edge2", previous_host="edge1", outcome=Outcome.DONE, downtime_s=0.5, seconds=2.0
    ),
    RowKind.EVENTS: Event(at=NOW, kind=EventKind.TASK_FAILED, host="edge1", task="slam", message=AWKWARD, id=7),
}  # fmt: skip
ROWS: dict[RowKind, dict[str, object]] = {
    RowKind.HOSTS: {"at": "2025-11-21T01:53:20.250Z", "host": "edge1", "status": "unreachable", "cores": None, "used_cores": None,
                 "total_bytes": None, "used_bytes": None, "rx_bytes_per_s": None, "tx_bytes_per_s": None, **dict.fromkeys(HOST_AMOUNT_COLUMNS)},
    RowKind.LINKS: {"at": "2025-11-21T01:53:20Z", "edge": "edge1", "robot": "robot1", "capacity_bytes_per_s": 6750000,
                 "used_bytes_per_s": 12.5, "rtt_ms": None},
    RowKind.TASKS: {"at": "2025-11-21T01:53:20Z", "task": "slam", "host": "edge1", "state": "ready", "used_cores": 0.1,
                 "used_bytes": 200000000, "used_bytes_per_s": 0, "links": 2, "age_s": 12, "instance": "i-1", "spec_hash": "h-1"},
    RowKind.METRICS: {"at": "2025-11-21T01:53:20Z", "task": "slam", "host": "edge1", "name": "map/loss", "value": -1e-07, "instance": "i-1"},
    RowKind.HANDOFFS: {"at": "2025-11-21T01:53:20Z", "task": "slam", "host": "edge2", "previous_host": "edge1", "outcome": "done",
                    "downtime_s": 0.5, "duration_s": 2, "gap_s": None},
    RowKind.EVENTS: {"at": "2025-11-21T01:53:20Z", "id": 7, "kind": "task-failed", "host": "edge1", "task": "slam", "message": escape_unprintable(AWKWARD)},
}  # fmt: skip


@pytest.mark.parametrize("kind", RowKind)
def test_json_lines(kind: RowKind) -> None:
    text = "".join(format_json_lines(kind, [POINTS[kind], POINTS[kind]]))
    lines = text.split("\n")
    assert lines.pop() == ""
    assert [json.loads(line) for line in lines] == [ROWS[kind]] * 2
    assert list(json.loads(lines[0])) == list(COLUMNS[kind]), "keys stand in the order of the columns"


@pytest.mark.parametrize("kind", RowKind)
def test_csv_round_trips(kind: RowKind) -> None:
    text = "".join(format_csv_lines(kind, [POINTS[kind], POINTS[kind]]))
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert rows == [{column: "" if value is None else str(value) for column, value in ROWS[kind].items()}] * 2
    assert text.startswith(",".join(COLUMNS[kind]) + "\n")


def test_no_rows_are_a_header_alone() -> None:
    assert list(format_csv_lines(RowKind.LINKS, [])) == [
        "at,edge,robot,capacity_bytes_per_s,used_bytes_per_s,rtt_ms\n"
    ]
    assert list(format_json_lines(RowKind.LINKS, [])) == []


@pytest.mark.parametrize("kind", RowKind)
def test_every_field_of_the_history_has_a_column(kind: RowKind) -> None:
    point = POINTS[kind]
    fields = {field.name for field in dataclasses.fields(point)} - {"usage", "used"}
    amounts = point.amounts if isinstance(point, HostPoint | TaskPoint) else {}
    assert sorted(COLUMNS[kind].values()) == sorted([*fields, *amounts])


def test_the_columns_are_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "concepts" / "metrics.md").read_text()
    rows = {
        kind: re.findall(r"`(\w+)`", columns)
        for kind, columns in re.findall(r"^\| (\w+) \| (`at`.*) \|$", page, re.MULTILINE)
    }
    assert rows == {kind.value: list(columns) for kind, columns in COLUMNS.items()}
