# SPDX-License-Identifier: Apache-2.0
"""Inserts into the history, each within a transaction of the caller."""

import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence

from edgectl.dataclass import dataclass
from edgectl.model.event import Event, EventKind
from edgectl.model.latency import list_latency_readings
from edgectl.model.plan import Action, Plan
from edgectl.model.point import TASK_AMOUNT_COLUMNS, TaskPoint, get_columns
from edgectl.model.result import Results
from edgectl.model.snapshot import HostStatus, LinkSample, Snapshot, TaskSample, TaskState
from edgectl.state import store_rows as rows
from edgectl.state.store_events import KnownFleet, KnownHost, KnownTask
from edgectl.state.store_rows import DamagedRowError

# Events that describe a lasting state of a task and are not repeated while it lasts.
_LASTING_KINDS = (EventKind.TASK_DEFERRED, EventKind.TASK_UNPLACED)

# Tasks that are gone and still known; each probe reads all of them.
_MAX_GONE_TASKS = 1000
# Snapshots whose samples of links are moved together, once there are so many.
_SNAPSHOTS_MOVED = 60
_MOVE_LOADS = (
    "INSERT OR REPLACE INTO loads SELECT * FROM new_loads ORDER BY link, at",
    "DELETE FROM new_loads",
    "DELETE FROM new_instants",
)
_REPEAT_LOADS = (
    "INSERT OR REPLACE INTO new_loads (link, at, capacity_bytes_per_s, used_bytes_per_s, rtt_ms)"
    " SELECT link, ?, capacity_bytes_per_s, used_bytes_per_s, rtt_ms FROM new_loads WHERE at = ?"
)

LinkNumbers = dict[tuple[str, str], int]
# By edge and robot.
Links = Mapping[str, Mapping[str, LinkSample]]


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenLinks:
    """The ``links`` whose samples of the instant ``at`` wait until they are moved."""

    at: float
    links: Links


def write_samples(
    connection: sqlite3.Connection,
    snapshot: Snapshot,
    numbers: LinkNumbers,
    written: WrittenLinks | None = None,
) -> WrittenLinks | None:
    """Insert all samples of ``snapshot``; what it left for the next one, if that is known.

    ``numbers``: as of `load_link_numbers`; those of new links are added. ``written``: what the snapshot
    before left, of which the file still has all.
    """
    _insert_rows(connection, "host_samples", rows.HOSTS.names, rows.host_rows_from_snapshot(snapshot))
    links = {edge: sample.links for edge, sample in snapshot.hosts.items() if sample.links}
    waits = bool(links) and _write_link_samples(connection, snapshot.taken_at, links, numbers, written)
    _write_task_samples(connection, list(rows.task_points_from_snapshot(snapshot)))
    _write_metric_readings(connection, snapshot)
    return WrittenLinks(at=snapshot.taken_at, links=links) if waits else None


def _write_link_samples(
    connection: sqlite3.Connection,
    at: float,
    links: Links,
    numbers: LinkNumbers,
    written: WrittenLinks | None,
) -> bool:
    """Insert the samples of ``links``; whether they wait, and no others of this instant do."""
    new = links
    if written is not None and _is_mostly_same(links, written.links):
        connection.execute(_REPEAT_LOADS, (at, written.at))
        new = {edge: each for edge, each in links.items() if each is not written.links[edge]}
    found = [((edge, robot), link) for edge, each in new.items() for robot, link in each.items()]
    unknown = [pair for pair, _ in found if pair not in numbers]
    if unknown:
        connection.executemany("INSERT OR IGNORE INTO links (edge, robot) VALUES (?, ?)", unknown)
        numbers.update(load_link_numbers(connection))
    connection.executemany(
        "INSERT OR REPLACE INTO new_loads (link, at, capacity_bytes_per_s, used_bytes_per_s, rtt_ms)"
        " VALUES (?, ?, ?, ?, ?)",
        [
            (numbers[pair], at, link.capacity_bytes_per_s, link.used_bytes_per_s, link.rtt_ms)
            for pair, link in found
        ],
    )
    # Of an instant that was there already the file may have more.
    is_new = connection.execute("INSERT OR IGNORE INTO new_instants (at) VALUES (?)", (at,)).rowcount == 1
    is_full = connection.execute("SELECT count(*) FROM new_instants").fetchone()[0] >= _SNAPSHOTS_MOVED
    for statement in _MOVE_LOADS if is_full else ():
        connection.execute(statement)
    return is_new and not is_full


def _is_mostly_same(links: Links, before: Links) -> bool:
    """Whether they are the same links, and those of most edges the very same samples.

    Most links of a watch are idle, and their edge has said nothing new: to repeat their samples in SQL costs
    less than to make rows of them.
    """
    same = sum(each is before.get(edge) for edge, each in links.items())
    return (
        2 * same > len(links)
        and links.keys() == before.keys()
        and all(each is before[edge] or each.keys() == before[edge].keys() for edge, each in links.items())
    )


def load_link_numbers(connection: sqlite3.Connection) -> LinkNumbers:
    """The number of each link that has samples, by edge and robot."""
    return {
        (edge, robot): link for link, edge, robot in connection.execute("SELECT link, edge, robot FROM links")
    }


def _write_task_samples(connection: sqlite3.Connection, points: Sequence[TaskPoint]) -> None:
    names = [(point.task, point.host, point.instance, point.spec_hash) for point in points]
    connection.executemany(
        "INSERT OR IGNORE INTO starts (task, host, instance, spec_hash) VALUES (?, ?, ?, ?)", names
    )
    columns = ("at", "state", *TASK_AMOUNT_COLUMNS, "age_s", "links")
    values = [(*get_columns(point, columns), *name) for name, point in zip(names, points, strict=True)]
    connection.executemany(
        f"INSERT OR REPLACE INTO uses (start, {', '.join(columns)})"  # noqa: S608
        f" SELECT start{', ?' * len(columns)} FROM starts WHERE task = ? AND host = ? AND instance = ? AND "
        "spec_hash = ?",
        values,
    )


def _write_metric_readings(connection: sqlite3.Connection, snapshot: Snapshot) -> None:
    """Insert application metrics that have changed: most seldom do, and those of completed jobs never."""
    said = [
        ((name, host, task.instance, task.spec_hash), metric, value)
        for host, sample in snapshot.hosts.items()
        for name, task in sample.tasks.items()
        for metric, value in [*task.metrics.items(), *_list_readings(task)]
    ]
    connection.executemany(
        "INSERT OR IGNORE INTO metrics (start, name)"
        " SELECT start, ? FROM starts WHERE task = ? AND host = ? AND instance = ? AND spec_hash = ?",
        [(metric, *start) for start, metric, _ in said],
    )
    connection.executemany(
        "INSERT OR REPLACE INTO readings (metric, at, value) SELECT metric, ?1, ?2 FROM metrics JOIN "
        "starts USING (start)"
        " WHERE name = ?3 AND task = ?4 AND host = ?5 AND instance = ?6 AND spec_hash = ?7 AND ?2 IS NOT"
        " (SELECT value FROM readings WHERE metric = metrics.metric AND at < ?1 ORDER BY at DESC LIMIT 1)",
        [(snapshot.taken_at, value, metric, *start) for start, metric, value in said],
    )


def _list_readings(task: TaskSample) -> list[tuple[str, float]]:
    """The latency of a task, which changes with every value."""
    return [] if task.latency is None else list_latency_readings(task.latency)


def write_plan(connection: sqlite3.Connection, made: Plan) -> None:
    """Insert a plan and its steps other than keep. A plan equal to the last one only counts there."""
    if is_plan_repeated(connection, made):
        sql = "UPDATE plans SET until = ?, times = times + 1 WHERE plan = (SELECT max(plan) FROM plans)"
        connection.execute(sql, (made.created_at,))
        return
    counts = json.dumps({action.value: count for action, count in made.summary.items()})
    sql = "INSERT INTO plans (at, until, times, policy, summary) VALUES (?, ?, 1, ?, ?)"
    number = connection.execute(sql, (made.created_at, made.created_at, made.policy.name, counts)).lastrowid
    values = [
        (number, step.task, step.action, each.reason, each.host, each.previous_host, each.total)
        for step in made.steps
        for each in (step.decision,)
        if _is_notable(step.action)
    ]
    _insert_rows(connection, "steps", "plan, task, action, reason, host, previous_host, total", values)


def is_plan_repeated(connection: sqlite3.Connection, made: Plan) -> bool:
    """Whether the last plan had the same actions and nothing was done since."""
    sql = "SELECT task, action, host FROM steps WHERE plan = (SELECT max(plan) FROM plans)"
    last = {task: (action, host) for task, action, host in connection.execute(sql)}
    done_since = "SELECT EXISTS (SELECT 1 FROM actions WHERE at > (SELECT max(until) FROM plans))"
    return not connection.execute(done_since).fetchone()[0] and last == {
        step.task: (step.action.value, step.decision.host) for step in made.steps if _is_notable(step.action)
    }


def _is_notable(action: Action) -> bool:
    return action not in (Action.KEEP, Action.NONE)


def write_actions(connection: sqlite3.Connection, results: Results, at: float) -> None:
    """Insert every action of an apply that ended at ``at``."""
    columns = (
        "at, revision, task, action, outcome, host, previous_host, located, downtime_s, seconds, error, gap_s"
    )
    _insert_rows(
        connection,
        "actions",
        columns,
        [rows.encode_action_row(result, results.revision, at) for result in results.actions],
    )


def write_events(connection: sqlite3.Connection, found: Iterable[Event]) -> None:
    """Insert events."""
    columns = "at, kind, host, task, message"
    _insert_rows(
        connection,
        "events",
        columns,
        [(event.at, event.kind, event.host, event.task, event.message) for event in found],
    )


def write_new_events(connection: sqlite3.Connection, found: Iterable[Event]) -> None:
    """Insert events, except those equal to the last event of their task: a lasting condition is recorded
    once.
    """
    write_events(connection, [event for event in found if not _is_event_repeated(connection, event)])


def _is_event_repeated(connection: sqlite3.Connection, event: Event) -> bool:
    sql = "SELECT kind, host, message FROM events WHERE task = ? ORDER BY id DESC LIMIT 1"
    last = connection.execute(sql, (event.task,)).fetchone()
    if event.kind is EventKind.TASK_OVERUSE and last is not None:
        return bool(last[:2] == (event.kind.value, event.host))  # its figures differ from reading to reading
    return event.kind in _LASTING_KINDS and last == (event.kind.value, event.host, event.message)


def load_known_fleet(connection: sqlite3.Connection) -> KnownFleet:
    """The last known state of the fleet.

    Raises:
        DamagedRowError: edgectl did not write it.
    """
    hosts = connection.execute(
        "SELECT host, at, since, status, boot_id, access_points FROM known_hosts"
    ).fetchall()
    tasks = connection.execute("SELECT task, at, host, state, instance, restarts FROM known_tasks").fetchall()
    try:
        return KnownFleet(
            hosts={row[0]: _decode_known_host(row) for row in hosts},
            tasks={row[0]: _decode_known_task(row) for row in tasks},
        )
    except ValueError as error:
        raise DamagedRowError(f"a row cannot be read: {error}") from error


def _decode_known_host(row: rows.Row) -> KnownHost:
    _name, at, since, status, boot_id, points = row
    return KnownHost(
        at=rows.decode_real(at),
        since=rows.decode_real(since),
        status=HostStatus(status),
        boot_id=rows.decode_text(boot_id),
        access_points=_decode_access_points(rows.decode_text(points)),
    )


def _decode_access_points(text: str) -> dict[str, str]:
    """Decode the access points by interface; a host of an edgectl that did not know them has none.

    Raises:
        ValueError: they are no such thing.
    """
    found = json.loads(text or "{}")
    if not isinstance(found, dict):
        raise ValueError("access points are no mapping")
    return {str(name): str(point) for name, point in found.items()}


def _decode_known_task(row: rows.Row) -> KnownTask:
    _name, at, host, state, instance, restarts = row
    return KnownTask(
        at=rows.decode_real(at),
        host=rows.nullable(rows.decode_text)(host),
        state=rows.nullable(TaskState)(state),
        instance=rows.decode_text(instance),
        restarts=rows.decode_int(restarts),
    )


def write_known_fleet(connection: sqlite3.Connection, before: KnownFleet, after: KnownFleet) -> bool:
    """Save the known state if it differs from ``before``; whether all of it is known from now on."""
    hosts = [
        (
            name,
            each.at,
            each.since,
            each.status,
            each.boot_id,
            json.dumps(dict(each.access_points), sort_keys=True) if each.access_points else "{}",
        )
        for name, each in after.hosts.items()
        if each is not before.hosts.get(name)
    ]
    tasks = [
        (name, each.at, each.host, each.state, each.instance, each.restarts)
        for name, each in after.tasks.items()
        if each is not before.tasks.get(name)
    ]
    _insert_rows(connection, "known_hosts", "host, at, since, status, boot_id, access_points", hosts)
    _insert_rows(connection, "known_tasks", "task, at, host, state, instance, restarts", tasks)
    gone = connection.execute(
        "DELETE FROM known_tasks WHERE host IS NULL AND task NOT IN"
        " (SELECT task FROM known_tasks WHERE host IS NULL ORDER BY at DESC LIMIT ?)",
        (_MAX_GONE_TASKS,),
    )
    return gone.rowcount == 0


def _insert_rows(
    connection: sqlite3.Connection, table: str, columns: str, values: Iterable[Sequence[object]]
) -> None:
    marks = ", ".join("?" for _ in columns.split(","))
    connection.executemany(f"INSERT OR REPLACE INTO {table} ({columns}) VALUES ({marks})", values)  # noqa: S608
