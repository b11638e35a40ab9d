# SPDX-License-Identifier: Apache-2.0
"""History of one fleet in SQLite: samples, plans, actions, handoffs and events.

Best effort: no failure here fails a command. Revisions and placements, which must survive, are in the
journal.
"""

import sqlite3
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

from edgectl.dataclass import dataclass
from edgectl.errors import StateError
from edgectl.model.event import Event
from edgectl.model.plan import Plan
from edgectl.model.point import HandoffPoint, HostPoint, LinkPoint, TaskPoint
from edgectl.model.profile import UsageSample
from edgectl.model.resource import NETWORK
from edgectl.model.result import Results
from edgectl.model.snapshot import Snapshot
from edgectl.state import store_action_events, store_events, store_prune, store_write
from edgectl.state import store_rows as rows
from edgectl.state.json_files import Warn, ignore_warning
from edgectl.state.store_connection import StoreConnection
from edgectl.state.store_file import HISTORY_FILE_NAME
from edgectl.state.store_memory import StoreMemory, recall
from edgectl.state.store_rows import Point, RowMapper

_DAY_S = 86400.0
_PRUNE_EVERY_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Retention:
    """Maximum age (s) of samples, and of plans, actions and events, and maximum file size (bytes)."""

    samples_s: float = 14 * _DAY_S
    records_s: float = 90 * _DAY_S
    max_bytes: int = 256 * 2**20


class Store:
    """History of one fleet; a context manager, for one thread at a time. If unusable it is empty and records
    nothing.
    """

    def __init__(self, path: Path, warn: Warn, retention: Retention) -> None:
        self._file = StoreConnection(path, warn)
        self._retention = retention
        self._memory: StoreMemory | None = None

    @classmethod
    def open(
        cls, fleet_dir: Path, *, warn: Warn = ignore_warning, retention: Retention | None = None
    ) -> "Store":
        """Open the history in ``fleet_dir``. Trouble is reported once through ``warn``; a broken file is set
        aside.
        """
        store = cls(fleet_dir / HISTORY_FILE_NAME, warn, retention or Retention())
        store._file.run(lambda _connection: None, None)
        return store

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, act: Callable[[sqlite3.Connection], None]) -> bool:
        """Write within a transaction; what is known of the file may be wrong from then on."""
        self._memory = None
        return self._file.write(act)

    # -- writing -----------------------------------------------------------------------------------

    def record_snapshot(
        self, snapshot: Snapshot, *, changing: bool = False, unfinished: Collection[str] = ()
    ) -> None:
        """Record the samples and the events that they show; the same snapshot again changes nothing.

        ``changing``: another edgectl is changing the fleet; starts and stops of tasks are left to its own
        record. ``unfinished``: tasks that an apply was changing when it was interrupted.
        """
        before, left = self._memory, list[StoreMemory]()

        def record(connection: sqlite3.Connection) -> None:
            left.clear()
            memory = recall(connection, before)
            written = store_write.write_samples(connection, snapshot, memory.links, memory.written)
            events, after = store_events.detect_events(
                memory.fleet, snapshot, changing=changing, unfinished=unfinished
            )
            store_write.write_events(connection, events)
            if store_write.write_known_fleet(connection, memory.fleet, after):
                known = store_events.sort_known_fleet(after)
                left.append(replace(memory, fleet=known, written=written))

        if self._write(record) and left:
            self._memory = left[0]

    def record_plan(self, plan: Plan) -> None:
        """Record a plan, with an event unless the plan before it had the same actions."""

        def record(connection: sqlite3.Connection) -> None:
            event = store_action_events.build_plan_event(plan)
            if event is not None and not store_write.is_plan_repeated(connection, plan):
                store_write.write_events(connection, [event])
            store_write.write_plan(connection, plan)
            store_write.write_new_events(connection, store_action_events.build_unplaced_events(plan))
            store_write.write_new_events(connection, store_action_events.build_overuse_events(plan))

        self._write(record)

    def record_results(self, plan: Plan, results: Results, at: float) -> None:  # noqa: ARG002
        """Record the results of an apply that ended at ``at`` (s since 1970), and its events."""

        def record(connection: sqlite3.Connection) -> None:
            store_write.write_actions(connection, results, at)
            known = store_write.load_known_fleet(connection)
            events, after = store_action_events.detect_result_events(known, results, at)
            store_write.write_new_events(connection, events)
            store_write.write_known_fleet(connection, known, after)

        self._write(record)

    def record_events(self, events: Iterable[Event]) -> None:
        """Record given events."""
        found = list(events)
        self._write(lambda connection: store_write.write_events(connection, found))

    # -- reading -----------------------------------------------------------------------------------

    def host_points(
        self, host: str | None = None, *, since: float | None = None, limit: int | None = None
    ) -> tuple[HostPoint, ...]:
        """Samples of ``host`` or of all, oldest first; the newest ``limit`` of each, not older than ``since``
        (s since 1970).
        """
        return self._newest(
            rows.HOSTS,
            "host_samples",
            "host",
            "SELECT host, host FROM known_hosts WHERE ?1 IS NULL OR host = ?1",
            (host,),
            since,
            limit,
        )

    def link_points(
        self,
        edge: str | None = None,
        robot: str | None = None,
        *,
        since: float | None = None,
        limit: int | None = None,
    ) -> tuple[LinkPoint, ...]:
        """Samples of the links of ``edge`` to ``robot`` or of all, oldest first; the newest ``limit`` of
        each.
        """
        links = "SELECT link, link FROM links WHERE (?1 IS NULL OR edge = ?1) AND (?2 IS NULL OR robot = ?2)"
        return self._newest(rows.LINKS, "link_samples", "link", links, (edge, robot), since, limit)

    def task_points(
        self, task: str | None = None, *, since: float | None = None, limit: int | None = None
    ) -> tuple[TaskPoint, ...]:
        """Samples of ``task`` or of all, on any host, oldest first; the newest ``limit`` of each task."""
        starts = "SELECT start, task FROM starts WHERE ?1 IS NULL OR task = ?1"
        return self._newest(rows.TASKS, "task_samples", "start", starts, (task,), since, limit)

    def task_starts(self, runs: Iterable[tuple[str, str, str]]) -> dict[tuple[str, str, str], float]:
        """The start (s since 1970) of each of ``runs`` (task, host, instance) as recorded with its age."""
        sql = (
            "SELECT at - age_s FROM starts JOIN uses USING (start) "
            "WHERE task = ? AND host = ? AND instance = ? AND age_s > 0 ORDER BY at DESC LIMIT 1"
        )

        def read(connection: sqlite3.Connection) -> dict[tuple[str, str, str], float]:
            found = {run: connection.execute(sql, run).fetchone() for run in runs}
            return {run: float(row[0]) for run, row in found.items() if row is not None}

        return self._file.run(read, {})

    def steady_usages(
        self, task: str, hosts: Collection[str], spec_hash: str, *, min_age_s: float, limit: int
    ) -> tuple[UsageSample, ...]:
        """The newest ``limit`` samples of ``task`` on ``hosts`` with this specification, alive and older than
        ``min_age_s``; newest first.
        """
        starts = "SELECT start, host FROM starts WHERE task = ? AND spec_hash = ? ORDER BY start DESC"

        def read(connection: sqlite3.Connection) -> tuple[UsageSample, ...]:
            found: list[UsageSample] = []
            for start, host in connection.execute(starts, (task, spec_hash)).fetchall():
                if host in hosts and len(found) < limit:
                    found += map(
                        rows.decode_usage,
                        connection.execute(rows.USAGE_QUERY, (start, min_age_s, limit - len(found))),
                    )
            return tuple(found)

        return self._file.run(read, ())

    def service_samples(
        self,
        task: str,
        host: str,
        spec_hash: str,
        metric: str,
        *,
        min_age_s: float,
        max_load: float,
        limit: int,
    ) -> tuple[float, ...]:
        """The newest ``limit`` values of ``metric`` of ``task`` on ``host`` with this specification, reported
        while others used at most ``max_load`` (0..1) of the cores; newest first.
        """
        sql = (
            "SELECT said.value FROM metric_samples AS said "
            "JOIN host_samples AS seen ON seen.host = said.host AND seen.at = said.at "
            "JOIN task_samples AS run ON run.task = said.task AND run.host = said.host "
            "AND run.instance = said.instance AND run.at = said.at "
            "WHERE said.task = ? AND said.host = ? AND said.spec_hash = ? AND said.name = ? "
            "AND run.age_s > ? AND seen.used_cores - run.used_cores <= ? * seen.cores "
            "ORDER BY said.at DESC LIMIT ?"
        )
        wanted = task, host, spec_hash, metric, min_age_s, max_load, limit

        def read(connection: sqlite3.Connection) -> tuple[float, ...]:
            return tuple(float(row[0]) for row in connection.execute(sql, wanted))

        return self._file.run(read, ())

    def used_shares(self, host: str, *, limit: int) -> tuple[tuple[str, tuple[float, ...]], ...]:
        """The newest ``limit`` readings of ``host`` and of each of its links, as shares of the capacity: the
        name of the resource, and the readings, oldest first.
        """

        def read(connection: sqlite3.Connection) -> tuple[tuple[str, tuple[float, ...]], ...]:
            links = connection.execute("SELECT link FROM links WHERE edge = ?", (host,)).fetchall()
            asked = [(name, sql, host) for name, sql in rows.HOST_SHARE_QUERIES.items()]
            asked += [(NETWORK.name, rows.LINK_SHARE_QUERY, link) for (link,) in links]
            return tuple(
                (
                    name,
                    tuple(rows.decode_real(share) for (share,) in connection.execute(sql, (key, limit)))[
                        ::-1
                    ],
                )
                for name, sql, key in asked
            )

        return self._file.run(read, ())

    def handoffs(self, *, since: float | None = None, limit: int | None = None) -> tuple[HandoffPoint, ...]:
        """Completed or failed moves and restarts, oldest first; the newest ``limit``."""
        sql = rows.HANDOFFS.select("handoffs", "WHERE at >= ? ORDER BY id DESC LIMIT ?")
        return self._select(rows.HANDOFFS, sql, (_since_or_earliest(since), _limit_or_all(limit)))[::-1]

    def events(
        self,
        *,
        after: int = 0,
        since: float | None = None,
        host: str | None = None,
        task: str | None = None,
        limit: int | None = None,
    ) -> tuple[Event, ...]:
        """Events with an id above ``after``, not older than ``since``, of ``host`` and ``task`` if given,
        oldest first.
        """
        fitting = "WHERE id > ?1 AND at >= ?2 AND (?3 IS NULL OR host = ?3) AND (?4 IS NULL OR task = ?4)"
        sql = rows.EVENTS.select("events", f"{fitting} ORDER BY id DESC LIMIT ?5")
        return self._select(
            rows.EVENTS, sql, (after, _since_or_earliest(since), host, task, _limit_or_all(limit))
        )[::-1]

    def stream(
        self, form: RowMapper[Point], table: str, order: str, *, since: float | None = None
    ) -> Iterator[Point]:
        """Yield rows of ``table`` not older than ``since``, sorted by ``order``, in bounded memory.

        Raises:
            StateError: the history cannot be read to its end.
        """
        try:
            for row in self._file.use().execute(
                form.select(table, f"WHERE at >= ? ORDER BY {order}"), (_since_or_earliest(since),)
            ):
                yield form.read(row)
        except (sqlite3.Error, ValueError, OverflowError, OSError) as error:
            raise StateError(f"the history cannot be read to its end: {self._file.path}: {error}") from error

    # -- keeping it small --------------------------------------------------------------------------

    def prune(self, now: float) -> None:
        """Delete rows older than the retention at ``now``, and the oldest samples while the file is too
        large.
        """
        keep = self._retention
        self._write(
            lambda connection: store_prune.delete_expired(
                connection, samples=now - keep.samples_s, records=now - keep.records_s
            )
        )
        self._file.run(lambda connection: store_prune.shrink_database(connection, keep.max_bytes), None)
        self._write(lambda connection: store_prune.write_prune_time(connection, now))

    def is_prune_due(self, now: float) -> bool:
        """Whether an hour has passed since the last prune by any edgectl, or since the first call."""
        at = self._file.run(store_prune.read_prune_time, now)
        if at == 0.0:
            self._write(lambda connection: store_prune.write_prune_time(connection, now))
        return at != 0.0 and abs(now - at) >= _PRUNE_EVERY_S

    # -- rows of a table ---------------------------------------------------------------------------

    def _newest(
        self,
        form: RowMapper[Point],
        table: str,
        key: str,
        groups: str,
        wanted: Sequence[str | None],
        since: float | None,
        limit: int | None,
    ) -> tuple[Point, ...]:
        """The newest rows of each group, oldest first. ``groups`` gives the keys in ``table`` with their
        group.
        """
        sql = form.select(table, f"WHERE {key} = ? AND at >= ? ORDER BY at DESC LIMIT ?")

        def read(connection: sqlite3.Connection) -> tuple[Point, ...]:
            found: dict[object, list[rows.Row]] = {}
            for each, group in connection.execute(groups, wanted).fetchall():
                found.setdefault(group, []).extend(
                    connection.execute(sql, (each, _since_or_earliest(since), _limit_or_all(limit)))
                )
            kept = [row for group in found.values() for row in _select_newest(group, limit)]
            return tuple(form.read(row) for row in sorted(kept, key=_get_row_instant))

        return self._file.run(read, ())

    def _select(self, form: RowMapper[Point], sql: str, values: Sequence[object]) -> tuple[Point, ...]:
        return self._file.run(
            lambda connection: tuple(form.read(row) for row in connection.execute(sql, values)), ()
        )


def _since_or_earliest(since: float | None) -> float:
    return -1e300 if since is None else since


def _limit_or_all(limit: int | None) -> int:
    return -1 if limit is None else limit


def _get_row_instant(row: rows.Row) -> float:
    return rows.decode_real(row[0])


def _select_newest(found: Sequence[rows.Row], limit: int | None) -> Sequence[rows.Row]:
    """The newest ``limit`` rows of a group with one or more keys."""
    return (
        found
        if limit is None or len(found) <= limit
        else sorted(found, key=_get_row_instant, reverse=True)[:limit]
    )
