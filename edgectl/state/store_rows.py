# SPDX-License-Identifier: Apache-2.0
"""Rows of the history to and from values. Values of a damaged file are refused."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from edgectl.model.event import Event, EventKind
from edgectl.model.point import (
    HOST_AMOUNT_COLUMNS,
    TASK_AMOUNT_COLUMNS,
    HandoffPoint,
    HistoryPoint,
    HostPoint,
    LinkPoint,
    MetricPoint,
    TaskPoint,
    get_columns,
)
from edgectl.model.profile import UsageSample
from edgectl.model.resource import HOST_RESOURCES, MEASURED_HOST_RESOURCES, NETWORK, TASK_RESOURCES, Usage
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.snapshot import (
    HostSample,
    HostStatus,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
)

Point = TypeVar("Point", bound=HistoryPoint)
Row = Sequence[Any]
ColumnDecoder = Callable[[Any], Any]


class DamagedRowError(ValueError):
    """A row that edgectl did not write."""


@dataclass(frozen=True, slots=True)
class RowMapper(Generic[Point]):
    """One kind of value, made by ``kind``, and the columns that hold it, in the order of a SELECT."""

    kind: Callable[..., Point]
    columns: Mapping[str, ColumnDecoder]

    @property
    def names(self) -> str:
        """The columns, for a SELECT or an INSERT."""
        return ", ".join(self.columns)

    def select(self, table: str, rest: str) -> str:
        """A query of these columns."""
        return f"SELECT {self.names} FROM {table} {rest}"  # noqa: S608

    def read(self, row: Row) -> Point:
        """One row.

        Raises:
            DamagedRowError: a column does not hold what it should.
        """
        try:
            return self.kind(
                **{name: read(value) for (name, read), value in zip(self.columns.items(), row, strict=True)}
            )
        except ValueError as error:
            raise DamagedRowError(f"a row cannot be read: {error}") from error

    def row(self, value: Point) -> tuple[object, ...]:
        """The same as a row to write."""
        return tuple(get_columns(value, self.columns))


def decode_real(value: object) -> float:
    """A finite number."""
    if isinstance(value, float) and math.isfinite(value):
        return value
    raise ValueError(f"not a number: {value!r}")


def decode_text(value: object) -> str:
    """Text."""
    if isinstance(value, str):
        return value
    raise ValueError(f"not text: {value!r}")


def decode_int(value: object) -> int:
    """A whole number from 0."""
    if isinstance(value, int) and value >= 0:
        return value
    raise ValueError(f"not a whole number: {value!r}")


def nullable(read: ColumnDecoder) -> ColumnDecoder:
    """The same, or None."""
    return lambda value: None if value is None else read(value)


def _host_point_from_columns(**columns: Any) -> HostPoint:  # noqa: ANN401
    usage = {}
    for each in HOST_RESOURCES:
        capacity, used = columns.pop(each.capacity_key), columns.pop(each.used_key)
        if capacity is not None and capacity > 0:
            usage[each.name] = ResourceUsage(capacity=capacity, used=used or 0.0)
    return HostPoint(usage=usage, **columns)


def _task_point_from_columns(**columns: Any) -> TaskPoint:  # noqa: ANN401
    used = {each.name: columns.pop(each.used_key) for each in TASK_RESOURCES}
    return TaskPoint(used=Usage(used), **columns)


HOSTS = RowMapper(
    _host_point_from_columns,
    {
        "at": decode_real,
        "host": decode_text,
        "status": HostStatus,
        **dict.fromkeys(HOST_AMOUNT_COLUMNS, nullable(decode_real)),
        "rx_bytes_per_s": nullable(decode_real),
        "tx_bytes_per_s": nullable(decode_real),
    },
)
LINKS = RowMapper(
    LinkPoint,
    {
        "at": decode_real,
        "edge": decode_text,
        "robot": decode_text,
        "capacity_bytes_per_s": decode_real,
        "used_bytes_per_s": decode_real,
        "rtt_ms": nullable(decode_real),
    },
)
TASKS = RowMapper(
    _task_point_from_columns,
    {
        "at": decode_real,
        "task": decode_text,
        "host": decode_text,
        "state": TaskState,
        **dict.fromkeys(TASK_AMOUNT_COLUMNS, decode_real),
        "instance": decode_text,
        "spec_hash": decode_text,
        "age_s": decode_real,
        "links": decode_int,
    },
)
METRICS = RowMapper(
    MetricPoint,
    {
        "at": decode_real,
        "task": decode_text,
        "host": decode_text,
        "name": decode_text,
        "value": decode_real,
        "instance": decode_text,
    },
)
# The samples from which a demand is measured: one seek per start. Read without a mapper, because there are a
# thousand of them per task.
USAGE_QUERY = (
    f"SELECT at, {', '.join(TASK_AMOUNT_COLUMNS)}, links FROM uses "  # noqa: S608
    "WHERE start = ? AND state IN ('running', 'ready') AND age_s >= ? ORDER BY at DESC LIMIT ?"
)
# Readings as shares of the capacity by resource of a host, newest first; and those of a link.
HOST_SHARE_QUERIES = {
    resource.name: f"SELECT {resource.used_key} / {resource.capacity_key} FROM host_samples "  # noqa: S608
    f"WHERE host = ? AND {resource.used_key} >= 0 AND {resource.capacity_key} > 0 ORDER BY at DESC LIMIT ?"
    for resource in MEASURED_HOST_RESOURCES
}
LINK_SHARE_QUERY = (
    "SELECT share FROM (SELECT at, used_bytes_per_s / capacity_bytes_per_s AS share FROM all_loads "
    "WHERE link = ? AND capacity_bytes_per_s > 0 ORDER BY at DESC LIMIT ?)"
)


def decode_usage(row: Row) -> UsageSample:
    """One row of ``USAGE_QUERY``.

    Raises:
        DamagedRowError: it holds no usage.
    """
    at, *used, links = row
    try:
        good = math.isfinite(at + sum(used)) and min(*used, links) >= 0
    except TypeError:
        good = False
    if not good:
        raise DamagedRowError(f"a row cannot be read: {row!r}")
    return UsageSample(at, tuple(used), links)


HANDOFFS = RowMapper(
    HandoffPoint,
    {
        "at": decode_real,
        "task": decode_text,
        "host": decode_text,
        "previous_host": nullable(decode_text),
        "outcome": Outcome,
        "downtime_s": nullable(decode_real),
        "seconds": decode_real,
        "gap_s": nullable(decode_real),
    },
)
EVENTS = RowMapper(
    Event,
    {
        "id": decode_int,
        "at": decode_real,
        "kind": EventKind,
        "host": nullable(decode_text),
        "task": nullable(decode_text),
        "message": decode_text,
    },
)


def host_rows_from_snapshot(snapshot: Snapshot) -> list[tuple[object, ...]]:
    """A row of `HOSTS` for every host of a snapshot."""
    return [_build_host_row(snapshot.taken_at, name, sample) for name, sample in snapshot.hosts.items()]


def _build_host_row(at: float, name: str, sample: HostSample) -> tuple[object, ...]:
    amounts: list[float | None] = []
    for resource in HOST_RESOURCES:
        usage = sample.usage.get(resource.name)
        amounts += (None, None) if usage is None else (usage.capacity, usage.used)
    interfaces = sample.device.interfaces.values()
    received = sum([each.rx_bytes_per_s for each in interfaces]) if interfaces else None
    sent = sum([each.tx_bytes_per_s for each in interfaces]) if interfaces else None
    return at, name, sample.status, *amounts, received, sent


def task_points_from_snapshot(snapshot: Snapshot) -> Iterable[TaskPoint]:
    """Every task of a snapshot, on every host where it was found."""
    for host, sample in snapshot.hosts.items():
        for name, task in sample.tasks.items():
            yield _build_task_point(snapshot.taken_at, host, name, task)


def _build_task_point(at: float, host: str, name: str, task: TaskSample) -> TaskPoint:
    """Throughput of which a part is not seen is recorded as 0: no figure of a demand (ADR 0096)."""
    return TaskPoint(
        at=at,
        task=name,
        host=host,
        state=task.state,
        used=Usage({**task.used, NETWORK.name: 0.0}) if task.partial else task.used,
        instance=task.instance,
        spec_hash=task.spec_hash,
        age_s=round(max(0.0, at - task.started_at), 3) if task.started_at else 0.0,
        links=len(task.links or ()),
    )


def encode_action_row(result: ActionResult, revision: int, at: float) -> tuple[object, ...]:
    """One action of an apply, in the order of the table."""
    seconds = sum(phase.seconds for phase in result.phases)
    return (
        at,
        revision,
        result.task,
        result.action,
        result.outcome,
        result.host,
        result.previous_host,
        result.located,
        result.downtime_s,
        seconds,
        result.error,
        result.gap_s,
    )
