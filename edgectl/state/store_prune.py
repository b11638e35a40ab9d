# SPDX-License-Identifier: Apache-2.0
"""Pruning of the history by age and by file size, the oldest samples first."""

import sqlite3

# Table of samples -> its first key, and the table with every value of it, so that the oldest are found
# without a full scan.
_SAMPLE_TABLES = {
    "host_samples": ("host", "known_hosts"),
    "loads": ("link", "links"),
    "new_loads": ("at", "new_instants"),
    "uses": ("start", "starts"),
    "readings": ("metric", "metrics"),
}
_RECORD_TABLES = {"plans": "until", "actions": "at", "events": "at"}
# Space to free at once, so that pruning does not run every hour; small, because a user waits for it.
_TARGET_SHARE = 0.98
_MIN_DELETED_SHARE = 1 / 64
_MAX_ROUNDS = 40


def delete_expired(connection: sqlite3.Connection, *, samples: float, records: float) -> None:
    """Delete samples older than ``samples``, and plans, actions and events older than ``records`` (s since
    1970).
    """
    for table, (key, groups) in _SAMPLE_TABLES.items():
        connection.execute(
            f"DELETE FROM {table} WHERE {key} IN (SELECT {key} FROM {groups}) AND at < ?",  # noqa: S608
            (samples,),
        )
    for table, instant in _RECORD_TABLES.items():
        connection.execute(f"DELETE FROM {table} WHERE {instant} < ?", (records,))  # noqa: S608
    connection.execute(
        "DELETE FROM metrics WHERE NOT EXISTS (SELECT 1 FROM readings WHERE readings.metric = metrics.metric)"
    )
    connection.execute(
        "DELETE FROM starts WHERE NOT EXISTS (SELECT 1 FROM uses WHERE uses.start = starts.start)"
    )
    connection.execute("DELETE FROM new_instants WHERE at NOT IN (SELECT at FROM new_loads)")
    connection.execute(
        "DELETE FROM links WHERE NOT EXISTS (SELECT 1 FROM all_loads WHERE all_loads.link = links.link)"
    )
    connection.execute("DELETE FROM known_tasks WHERE host IS NULL AND at < ?", (records,))
    connection.execute("DELETE FROM steps WHERE plan NOT IN (SELECT plan FROM plans)")


def shrink_database(connection: sqlite3.Connection, most: int) -> None:
    """If the file holds more than ``most`` bytes, delete the oldest samples, then the oldest other rows, and
    release the space.
    """
    if _count_used_bytes(connection) > most:
        for _ in range(_MAX_ROUNDS):
            held = _count_used_bytes(connection)
            if held <= most * _TARGET_SHARE or not _delete_oldest(
                connection, max(_MIN_DELETED_SHARE, 1 - most * _TARGET_SHARE / held)
            ):
                break
    if not connection.execute("PRAGMA freelist_count").fetchone()[0]:
        return
    # As a script: otherwise a statement whose rows have no columns is left after the first row, which is one
    # page.
    connection.executescript("PRAGMA incremental_vacuum; PRAGMA wal_checkpoint(TRUNCATE);")


def _count_used_bytes(connection: sqlite3.Connection) -> int:
    """Bytes in use, without free pages."""
    pages, free, size = (
        connection.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("page_count", "freelist_count", "page_size")
    )
    return int((pages - free) * size)


def _delete_oldest(connection: sqlite3.Connection, share: float) -> bool:
    """Delete the first ``share`` of the time covered by samples, or else by records.

    Whether there was any.
    """
    samples, records = (
        _compute_cutoff(connection, _SAMPLE_SPANS, share),
        _compute_cutoff(connection, _RECORD_SPANS, share),
    )
    if samples is None and records is None:
        return False
    never = float("-inf")
    connection.execute("BEGIN IMMEDIATE")
    delete_expired(
        connection,
        samples=samples or never,
        records=never if samples is not None or records is None else records,
    )
    connection.execute("COMMIT")
    return True


_SAMPLE_SPANS = " UNION ALL ".join(
    f"SELECT (SELECT min(at) FROM {table} WHERE {table}.{key} = {groups}.{key}) AS first,"  # noqa: S608
    f" (SELECT max(at) FROM {table} WHERE {table}.{key} = {groups}.{key}) AS last FROM {groups}"
    for table, (key, groups) in _SAMPLE_TABLES.items()
)
_RECORD_SPANS = " UNION ALL ".join(
    f"SELECT min({at}) AS first, max({at}) AS last FROM {table}"  # noqa: S608
    for table, at in _RECORD_TABLES.items()
)


def _compute_cutoff(connection: sqlite3.Connection, spans: str, share: float) -> float | None:
    """The end of the first ``share`` of the time covered by ``spans``, None if there is none."""
    first, last = connection.execute(f"SELECT min(first), max(last) FROM ({spans})").fetchone()  # noqa: S608
    if first is None:
        return None
    return float(first + (last - first) * share) if last > first else float(last) + 1.0


def write_prune_time(connection: sqlite3.Connection, now: float) -> None:
    """Record that the history was pruned at ``now`` (s since 1970)."""
    connection.execute("INSERT OR REPLACE INTO marks (name, at) VALUES ('pruned', ?)", (now,))


def read_prune_time(connection: sqlite3.Connection) -> float:
    """Time of the last prune in s since 1970; 0 for never."""
    row = connection.execute("SELECT at FROM marks WHERE name = 'pruned'").fetchone()
    return 0.0 if row is None else float(row[0])
