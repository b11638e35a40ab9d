"""Keeping the history small: by age, and by the size of the file, the oldest samples first."""

import sqlite3

# Each kind of rows that go by age, in the order in which they make room.
_SAMPLES = ("host_samples", "link_samples", "uses")
_RECORDS = ("plans", "actions", "events")
# What is left after making room, so that not every hour begins with it again.
_ROOM = 0.9
_MOST_ROUNDS = 40


def drop(connection: sqlite3.Connection, *, samples: float, records: float) -> None:
    """Delete samples older than ``samples``, and plans, actions and events older than ``records`` (s since 1970)."""
    for table in _SAMPLES:
        _older(connection, table, samples)
    for table in _RECORDS:
        _older(connection, table, records)
    connection.execute("DELETE FROM starts WHERE NOT EXISTS (SELECT 1 FROM uses WHERE uses.start = starts.start)")
    connection.execute("DELETE FROM steps WHERE plan NOT IN (SELECT plan FROM plans)")


def _older(connection: sqlite3.Connection, table: str, at: float) -> None:
    connection.execute(f"DELETE FROM {table} WHERE at < ?", (at,))  # noqa: S608


def shrink(connection: sqlite3.Connection, most: int) -> None:
    """Delete the oldest eighth until the file, given back to the disk what is free, holds at most ``most`` bytes."""
    for _ in range(_MOST_ROUNDS):
        if _bytes(connection) <= most:
            break
        most = int(most * _ROOM) if most else most
        connection.execute("BEGIN IMMEDIATE")
        gone = _oldest_eighth(connection, _SAMPLES) or _oldest_eighth(connection, _RECORDS)
        connection.execute("COMMIT")
        if not gone:
            break
    connection.execute("PRAGMA incremental_vacuum").fetchall()
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()


def _bytes(connection: sqlite3.Connection) -> int:
    """What the file holds, without its free pages."""
    pages, free, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count", "page_size"))
    return int((pages - free) * size)


def _oldest_eighth(connection: sqlite3.Connection, tables: tuple[str, ...]) -> bool:
    """Delete the first eighth of the time that ``tables`` reach over; whether there was anything."""
    spans = [connection.execute(f"SELECT min(at), max(at) FROM {table}").fetchone() for table in tables]  # noqa: S608
    known = [span for span in spans if span[0] is not None]
    if not known:
        return False
    first, last = min(span[0] for span in known), max(span[1] for span in known)
    until = first + (last - first) / 8 if last > first else last + 1.0
    drop(connection, samples=until if tables is _SAMPLES else first, records=until if tables is _RECORDS else first)
    return True


def mark(connection: sqlite3.Connection, now: float) -> None:
    """Remember that the history was made smaller at ``now`` (s since 1970)."""
    connection.execute("INSERT OR REPLACE INTO marks (name, at) VALUES ('pruned', ?)", (now,))


def marked(connection: sqlite3.Connection) -> float:
    """When that was last, in s since 1970; 0 for never."""
    row = connection.execute("SELECT at FROM marks WHERE name = 'pruned'").fetchone()
    return 0.0 if row is None else float(row[0])
