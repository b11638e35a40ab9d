# SPDX-License-Identifier: Apache-2.0
"""Database file of a fleet's history: created private, opened, and set aside if broken."""

import contextlib
import fcntl
import os
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path

from edgectl.errors import StateError
from edgectl.model.point import HOST_AMOUNT_COLUMNS, TASK_AMOUNT_COLUMNS
from edgectl.state.json_files import set_aside
from edgectl.state.paths import open_private_file

HISTORY_FILE_NAME = "history.db"
_BUSY_S = 5.0
_SIDE_FILE_SUFFIXES = ("-wal", "-shm")
# Each may be as large as a history may become.
_MAX_BROKEN_FILES = 2
# Errors that do not mean damage: a retry, another disk or a later time may succeed. All others mean damage.
_TRANSIENT_CODES = frozenset(
    {
        sqlite3.SQLITE_PERM,
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_NOMEM,
        sqlite3.SQLITE_READONLY,
        sqlite3.SQLITE_INTERRUPT,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_TOOBIG,
        sqlite3.SQLITE_CONSTRAINT,
        sqlite3.SQLITE_NOLFS,
        sqlite3.SQLITE_AUTH,
    }
)
# Rows of one host, link or start are stored together, oldest first, so that the newest are one seek away and
# the oldest are deleted cheaply. Repeated names are stored once, in `links` and `starts`; the views join them
# for users of SQL.
_BASE_SCHEMA = """
CREATE TABLE host_samples (
  host TEXT NOT NULL, at REAL NOT NULL, status TEXT NOT NULL, cores REAL, used_cores REAL,
  total_bytes REAL, used_bytes REAL,
  rx_bytes_per_s REAL, tx_bytes_per_s REAL, PRIMARY KEY (host, at)) STRICT, WITHOUT ROWID;
CREATE TABLE links (
  link INTEGER PRIMARY KEY, edge TEXT NOT NULL, robot TEXT NOT NULL, UNIQUE (edge, robot)) STRICT;
CREATE TABLE loads (
  link INTEGER NOT NULL, at REAL NOT NULL, capacity_bytes_per_s REAL NOT NULL,
  used_bytes_per_s REAL NOT NULL, rtt_ms REAL,
  PRIMARY KEY (link, at)) STRICT, WITHOUT ROWID;
CREATE VIEW link_samples AS
  SELECT at, edge, robot, capacity_bytes_per_s, used_bytes_per_s, rtt_ms, link FROM links
  JOIN loads USING (link);
CREATE TABLE starts (
  start INTEGER PRIMARY KEY, task TEXT NOT NULL, host TEXT NOT NULL, instance TEXT NOT NULL,
  spec_hash TEXT NOT NULL,
  UNIQUE (task, host, instance, spec_hash)) STRICT;
CREATE TABLE uses (
  start INTEGER NOT NULL, at REAL NOT NULL, state TEXT NOT NULL, used_cores REAL NOT NULL,
  used_bytes REAL NOT NULL,
  used_bytes_per_s REAL NOT NULL, age_s REAL NOT NULL, links INTEGER NOT NULL, PRIMARY KEY (start,
  at)) STRICT, WITHOUT ROWID;
CREATE VIEW task_samples AS
  SELECT at, task, host, state, used_cores, used_bytes, used_bytes_per_s, instance, spec_hash, age_s,
  links, start
  FROM starts JOIN uses USING (start);
CREATE TABLE plans (
  plan INTEGER PRIMARY KEY, at REAL NOT NULL, until REAL NOT NULL, times INTEGER NOT NULL,
  policy TEXT NOT NULL, summary TEXT NOT NULL)
  STRICT;
CREATE TABLE steps (
  plan INTEGER NOT NULL, task TEXT NOT NULL, action TEXT NOT NULL, reason TEXT NOT NULL, host TEXT,
  previous_host TEXT, total REAL,
  PRIMARY KEY (plan, task)) STRICT, WITHOUT ROWID;
CREATE TABLE actions (
  id INTEGER PRIMARY KEY, at REAL NOT NULL, revision INTEGER NOT NULL, task TEXT NOT NULL,
  action TEXT NOT NULL, outcome TEXT NOT NULL,
  host TEXT, previous_host TEXT, located TEXT, downtime_s REAL, seconds REAL NOT NULL,
  error TEXT NOT NULL) STRICT;
CREATE VIEW handoffs AS
  SELECT at, task, host, previous_host, outcome, downtime_s, seconds, id FROM actions
  WHERE action IN ('move', 'restart') AND outcome IN ('done', 'failed') AND host IS NOT NULL;
CREATE TABLE events (
  id INTEGER PRIMARY KEY AUTOINCREMENT, at REAL NOT NULL, kind TEXT NOT NULL, host TEXT, task TEXT,
  message TEXT NOT NULL) STRICT;
CREATE INDEX events_of_task ON events (task, id);
CREATE TABLE known_hosts (
  host TEXT PRIMARY KEY, at REAL NOT NULL, since REAL NOT NULL, status TEXT NOT NULL,
  boot_id TEXT NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE known_tasks (
  task TEXT PRIMARY KEY, at REAL NOT NULL, host TEXT, state TEXT, instance TEXT NOT NULL,
  restarts INTEGER NOT NULL)
  STRICT, WITHOUT ROWID;
CREATE TABLE marks (name TEXT PRIMARY KEY, at REAL NOT NULL) STRICT, WITHOUT ROWID;
"""
_METRICS_SCHEMA = """
CREATE TABLE metrics (
  metric INTEGER PRIMARY KEY, start INTEGER NOT NULL, name TEXT NOT NULL, UNIQUE (start, name)) STRICT;
CREATE TABLE readings (
  metric INTEGER NOT NULL, at REAL NOT NULL, value REAL NOT NULL, PRIMARY KEY (metric, at)) STRICT,
  WITHOUT ROWID;
CREATE VIEW metric_samples AS
  SELECT at, task, host, name, value, instance, spec_hash, metric FROM starts
  JOIN metrics USING (start) JOIN readings USING (metric);
"""
# The newest samples of links, until so many have come that they are moved to `loads` together: there each
# link has pages of its own, all of which a snapshot would write (ADR 205).
_NEW_LOADS_SCHEMA = """
CREATE TABLE new_loads (
  link INTEGER NOT NULL, at REAL NOT NULL, capacity_bytes_per_s REAL NOT NULL,
  used_bytes_per_s REAL NOT NULL, rtt_ms REAL,
  PRIMARY KEY (link, at)) STRICT, WITHOUT ROWID;
CREATE VIEW all_loads AS SELECT * FROM loads UNION ALL SELECT * FROM new_loads;
DROP VIEW link_samples;
CREATE VIEW link_samples AS
  SELECT at, edge, robot, capacity_bytes_per_s, used_bytes_per_s, rtt_ms, link FROM links
  JOIN all_loads USING (link);
"""
# They are kept by instant (ADR 213), so a snapshot writes few pages. Who reads a link looks it up under each
# of the instants, which are few.
_INSTANTS_SCHEMA = """
CREATE TABLE new_instants (at REAL PRIMARY KEY) STRICT, WITHOUT ROWID;
INSERT OR REPLACE INTO loads SELECT * FROM new_loads;
DROP VIEW link_samples;
DROP VIEW all_loads;
DROP TABLE new_loads;
CREATE TABLE new_loads (
  link INTEGER NOT NULL, at REAL NOT NULL, capacity_bytes_per_s REAL NOT NULL,
  used_bytes_per_s REAL NOT NULL, rtt_ms REAL,
  PRIMARY KEY (at, link)) STRICT, WITHOUT ROWID;
CREATE VIEW all_loads AS SELECT * FROM loads UNION ALL
  SELECT new_loads.* FROM new_instants CROSS JOIN new_loads ON new_loads.at = new_instants.at;
CREATE VIEW link_samples AS
  SELECT at, edge, robot, capacity_bytes_per_s, used_bytes_per_s, rtt_ms, link FROM links
  JOIN all_loads USING (link);
"""
# Migrations: the statements that each schema adds to the one before.
_MIGRATIONS = (_BASE_SCHEMA, _METRICS_SCHEMA, _NEW_LOADS_SCHEMA, _INSTANTS_SCHEMA)
SCHEMA_VERSION = len(_MIGRATIONS)
# Columns that are added to a file that lacks them, by table: of a resource that is newer than the file, and
# of what edgectl did not know before. An edgectl that does not know them reads and writes the others.
_ADDED_COLUMNS = {
    "host_samples": dict.fromkeys(HOST_AMOUNT_COLUMNS, "REAL"),
    "uses": dict.fromkeys(TASK_AMOUNT_COLUMNS, "REAL NOT NULL DEFAULT 0"),
    "actions": {"gap_s": "REAL"},
    "known_hosts": {"access_points": "TEXT NOT NULL DEFAULT ''"},
}
_VIEWS = f"""
DROP VIEW task_samples;
CREATE VIEW task_samples AS
  SELECT at, task, host, state, {", ".join(TASK_AMOUNT_COLUMNS)}, instance, spec_hash, age_s, links, start
  FROM starts JOIN uses USING (start);
DROP VIEW handoffs;
CREATE VIEW handoffs AS
  SELECT at, task, host, previous_host, outcome, downtime_s, seconds, id, gap_s FROM actions
  WHERE action IN ('move', 'restart') AND outcome IN ('done', 'failed') AND host IS NOT NULL
"""  # noqa: S608


class NewerSchemaError(StateError):
    """A newer edgectl wrote the history."""


def is_transient_error(error: sqlite3.Error) -> bool:
    """Whether ``error`` does not mean damage (a full or read-only disk, another writer)."""
    return getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF in _TRANSIENT_CODES


def open_database(path: Path) -> sqlite3.Connection:
    """Open the history at ``path``, creating it if missing.

    Raises:
        sqlite3.Error: it is broken, or cannot be used (see ``is_transient_error``).
        StateError: it cannot be created, or a newer edgectl wrote it.
    """
    if not path.exists():
        # SQLite gives the other two files the permissions of this one.
        with contextlib.suppress(StateError):
            os.close(open_private_file(path, os.O_RDWR | os.O_EXCL))
    connection = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False)
    try:
        _configure_connection(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def _configure_connection(connection: sqlite3.Connection, path: Path) -> None:
    # An incomplete file need not be synced: after a power failure it is created anew.
    connection.executescript(
        "PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON; PRAGMA synchronous = OFF;"
    )
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version > SCHEMA_VERSION:
        raise NewerSchemaError(
            f"{path} was written by a newer edgectl (schema {version})",
            hint="use that edgectl, or move the file away",
        )
    if version < SCHEMA_VERSION:
        with lock_directory(path.parent):
            _create_tables(connection)
    if _list_missing_columns(connection):
        with lock_directory(path.parent):
            _add_missing_columns(connection)
    connection.executescript("PRAGMA journal_size_limit = 4194304; PRAGMA synchronous = NORMAL;")


def _create_tables(connection: sqlite3.Connection) -> None:
    """Create missing tables; another edgectl may have done so just now."""
    connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("BEGIN IMMEDIATE")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    for statement in "".join(_MIGRATIONS[version:]).split(";\n"):
        connection.execute(statement)
    connection.execute(f"PRAGMA user_version = {max(version, SCHEMA_VERSION)}")
    connection.execute("COMMIT")


def _list_missing_columns(connection: sqlite3.Connection) -> list[str]:
    """``table ADD COLUMN column type`` for each column that is newer than the file."""
    return [
        f"{table} ADD COLUMN {column} {kind}"
        for table, columns in _ADDED_COLUMNS.items()
        for known in [{row[1] for row in connection.execute(f"PRAGMA table_info({table})")}]
        for column, kind in columns.items()
        if column not in known
    ]


def _add_missing_columns(connection: sqlite3.Connection) -> None:
    """Add missing columns; another edgectl may have done so just now."""
    connection.execute("BEGIN IMMEDIATE")
    missing = _list_missing_columns(connection)
    for column in missing:
        connection.execute(f"ALTER TABLE {column}")
    for statement in _VIEWS.split(";\n") if missing else ():
        connection.execute(statement)
    connection.execute("COMMIT")


@contextlib.contextmanager
def lock_directory(fleet_dir: Path) -> Iterator[None]:
    """Prevent every other edgectl from creating or setting aside the file: a lock on the directory, waited
    for up to 5 s.
    """
    descriptor = os.open(fleet_dir, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        deadline = time.monotonic() + _BUSY_S
        while not _try_lock(descriptor) and time.monotonic() < deadline:
            time.sleep(0.01)
        yield
    finally:
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def get_file_identity(path: Path) -> tuple[int, int] | None:
    """Identity of the file at ``path`` now; None if there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def set_aside_database(path: Path, opened: tuple[int, int] | None) -> Path | None:
    """Set the broken file aside if it is still the ``opened`` one, and return its new path.

    The log is moved first: without its database it would be applied to the next one.

    Raises:
        OSError: the directory cannot be written.
    """
    with lock_directory(path.parent):
        if opened is None or get_file_identity(path) != opened:
            return None
        for part in _SIDE_FILE_SUFFIXES:
            path.with_name(path.name + part).unlink(missing_ok=True)
        aside = sorted(path.parent.glob(f"{path.name}.broken-*"), key=lambda each: each.stat().st_mtime)
        for oldest in aside[: len(aside) + 1 - _MAX_BROKEN_FILES]:
            oldest.unlink(missing_ok=True)
        return set_aside(path)
