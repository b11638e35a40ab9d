"""History as rows for other programs: CSV and JSON Lines with stable columns. Pure.

Column names contain units; instants are RFC 3339 in UTC; unknown values are empty (null in JSON).
"""

import csv
from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum

from edgectl.formats.document import dump_line, encode_number
from edgectl.model.event import Event
from edgectl.model.point import HandoffPoint, HostPoint, LinkPoint, MetricPoint, TaskPoint
from edgectl.model.text import escape_unprintable
from edgectl.units import format_instant

HistoryPoint = HostPoint | LinkPoint | TaskPoint | MetricPoint | HandoffPoint | Event
RowValue = str | int | float | None


class RowKind(StrEnum):
    """Kinds of rows."""

    HOSTS = "hosts"
    LINKS = "links"
    TASKS = "tasks"
    METRICS = "metrics"
    HANDOFFS = "handoffs"
    EVENTS = "events"


# Columns by kind, each with its field. New ones are added at the end.
COLUMNS: Mapping[RowKind, Mapping[str, str]] = {
    RowKind.HOSTS: {
        "at": "at",
        "host": "host",
        "status": "status",
        "cores": "cores",
        "used_cores": "used_cores",
        "total_bytes": "total_bytes",
        "used_bytes": "used_bytes",
        "rx_bytes_per_s": "rx_bytes_per_s",
        "tx_bytes_per_s": "tx_bytes_per_s",
    },
    RowKind.LINKS: {
        "at": "at",
        "edge": "edge",
        "robot": "robot",
        "capacity_bytes_per_s": "capacity_bytes_per_s",
        "used_bytes_per_s": "used_bytes_per_s",
        "rtt_ms": "rtt_ms",
    },
    RowKind.TASKS: {
        "at": "at",
        "task": "task",
        "host": "host",
        "state": "state",
        "used_cores": "used_cores",
        "used_bytes": "used_bytes",
        "used_bytes_per_s": "used_bytes_per_s",
        "links": "links",
        "age_s": "age_s",
        "instance": "instance",
        "spec_hash": "spec_hash",
    },
    RowKind.METRICS: {
        "at": "at",
        "task": "task",
        "host": "host",
        "name": "name",
        "value": "value",
        "instance": "instance",
    },
    RowKind.HANDOFFS: {
        "at": "at",
        "task": "task",
        "host": "host",
        "previous_host": "previous_host",
        "outcome": "outcome",
        "downtime_s": "downtime_s",
        "duration_s": "seconds",
    },
    RowKind.EVENTS: {
        "at": "at",
        "id": "id",
        "kind": "kind",
        "host": "host",
        "task": "task",
        "message": "message",
    },
}


class _LineEcho:
    """A file for csv.writer that returns each line."""

    def write(self, line: str) -> str:
        return line


def format_csv_lines(kind: RowKind, points: Iterable[HistoryPoint]) -> Iterator[str]:
    """The header, then one line per row, readable by the csv module."""
    writer = csv.writer(_LineEcho(), lineterminator="\n")
    yield writer.writerow(COLUMNS[kind])
    for point in points:
        yield writer.writerow(_build_row(kind, point).values())


def format_json_lines(kind: RowKind, points: Iterable[HistoryPoint]) -> Iterator[str]:
    """One JSON object per line."""
    return (dump_line(_build_row(kind, point)) for point in points)


def _build_row(kind: RowKind, point: HistoryPoint) -> dict[str, RowValue]:
    return {column: _format_cell(name, getattr(point, name)) for column, name in COLUMNS[kind].items()}


def _format_cell(name: str, value: RowValue) -> RowValue:
    if name == "at" and isinstance(value, float):
        return format_instant(value)
    if isinstance(value, StrEnum):
        return value.value
    if isinstance(value, str):
        return escape_unprintable(value)
    return encode_number(value) if isinstance(value, float) else value
