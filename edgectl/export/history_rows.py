# SPDX-License-Identifier: Apache-2.0
"""History as rows for other programs: CSV and JSON Lines with stable columns. Pure.

Column names contain units; instants are RFC 3339 in UTC; unknown values are empty (null in JSON).
"""

import csv
from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum

from edgectl.formats.document import dump_line, encode_number
from edgectl.model.point import (
    HOST_AMOUNT_COLUMNS,
    TASK_AMOUNT_COLUMNS,
    HistoryPoint,
    get_columns,
)
from edgectl.model.text import escape_unprintable
from edgectl.units import format_instant

RowValue = str | int | float | None


class RowKind(StrEnum):
    """Kinds of rows."""

    HOSTS = "hosts"
    LINKS = "links"
    TASKS = "tasks"
    METRICS = "metrics"
    HANDOFFS = "handoffs"
    EVENTS = "events"


# The columns of the first release, in its order; those of resources that came later follow.
_FIRST_HOST_COLUMNS = (
    "at", "host", "status", "cores", "used_cores", "total_bytes", "used_bytes", "rx_bytes_per_s",
    "tx_bytes_per_s",
)  # fmt: skip
_FIRST_TASK_COLUMNS = (
    "at", "task", "host", "state", "used_cores", "used_bytes", "used_bytes_per_s", "links", "age_s",
    "instance", "spec_hash",
)  # fmt: skip


def _name_by_field(*fields: str) -> dict[str, str]:
    return {name: name for name in fields}


# Columns by kind, each with its field or amount. New ones are added at the end.
COLUMNS: Mapping[RowKind, Mapping[str, str]] = {
    RowKind.HOSTS: _name_by_field(*_FIRST_HOST_COLUMNS, *HOST_AMOUNT_COLUMNS),
    RowKind.LINKS: _name_by_field(
        "at", "edge", "robot", "capacity_bytes_per_s", "used_bytes_per_s", "rtt_ms"
    ),
    RowKind.TASKS: _name_by_field(*_FIRST_TASK_COLUMNS, *TASK_AMOUNT_COLUMNS),
    RowKind.METRICS: _name_by_field("at", "task", "host", "name", "value", "instance"),
    RowKind.HANDOFFS: {
        **_name_by_field("at", "task", "host", "previous_host", "outcome", "downtime_s"),
        "duration_s": "seconds",
        "gap_s": "gap_s",
    },
    RowKind.EVENTS: _name_by_field("at", "id", "kind", "host", "task", "message"),
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
    columns = COLUMNS[kind]
    values = get_columns(point, columns.values())
    return {column: _format_cell(column, value) for column, value in zip(columns, values, strict=True)}


def _format_cell(name: str, value: object) -> RowValue:
    if name == "at" and isinstance(value, float):
        return format_instant(value)
    if isinstance(value, StrEnum):
        return value.value
    if isinstance(value, str):
        return escape_unprintable(value)
    if isinstance(value, float):
        return encode_number(value)
    return value if isinstance(value, int) else None
