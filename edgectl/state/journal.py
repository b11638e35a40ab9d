# SPDX-License-Identifier: Apache-2.0
"""Append-only journal of changes to a fleet: lines chained by checksums, synced before the change they
announce.

The journal is also the only source of the revision number and of the plans already applied.
"""

import hashlib
import json
import os
import threading
import time
from collections.abc import Callable
from dataclasses import field
from pathlib import Path
from typing import Self

from edgectl.dataclass import dataclass
from edgectl.errors import StateError
from edgectl.state.failpoints import hit_failpoint
from edgectl.state.journal_reader import JOURNAL_FORMAT, JournalEntry, JournalSummary, read_journal
from edgectl.state.json_files import Warn, ignore_warning, set_aside
from edgectl.state.paths import open_private_file
from edgectl.units import format_instant

JOURNAL_FILE_NAME = "journal.jsonl"
# Rotate a longer file: every apply reads it.
_ROTATE_BYTES = 1 << 20


@dataclass(slots=True)
class Journal:
    """The open journal of one fleet; appending is thread-safe. Open it while holding the fleet's lock.

    ``on_append`` is told of each entry once it is on disk, before ``append`` returns.
    """

    path: Path
    log: JournalSummary
    clock: Callable[[], float]
    _descriptor: int
    _last: str
    on_append: Callable[[JournalEntry], None] = lambda _entry: None
    _guard: threading.Lock = field(default_factory=threading.Lock)

    @classmethod
    def open(
        cls,
        fleet_dir: Path,
        *,
        clock: Callable[[], float] = time.time,
        warn: Warn = ignore_warning,
        on_append: Callable[[JournalEntry], None] = lambda _entry: None,
    ) -> Self:
        """Open for appending. A torn last line is cut off and recorded; a damaged file is set aside and a new
        one started.

        A long file is renamed to ``journal-REVISION.jsonl``; the new one starts with the hash of its last
        line.

        Raises:
            StateError: a newer edgectl wrote it, or the disk cannot be written.
        """
        path = fleet_dir / JOURNAL_FILE_NAME
        log = read_journal(path)
        salvaged = log
        if log.broken:
            warn(f"{path} is damaged at line {log.broken}; set aside as {set_aside(path).name}")
            log = JournalSummary()
        elif log.size > _ROTATE_BYTES and log.sound and not log.doubtful:
            path.rename(path.with_name(f"journal-{log.revision}.jsonl"))
            log = JournalSummary()
        journal = cls(
            path=path,
            log=salvaged,
            clock=clock,
            _descriptor=open_private_file(path, os.O_WRONLY | os.O_APPEND),
            _last=log.last,
            on_append=on_append,
        )
        if log.torn:
            os.ftruncate(journal._descriptor, log.size)
            warn(f"{path}: an unfinished last line ({log.torn} bytes) was cut off; its action never began")
            journal.append("torn", bytes=log.torn)
        if log is not salvaged:
            applied = salvaged.applied if salvaged.broken else salvaged.begun
            journal.append(
                "continued", revision=salvaged.revision, applied=sorted(applied), after=salvaged.last
            )
        return journal

    def append(self, event: str, **fields: object) -> None:
        """Write one entry and wait until it is on disk.

        Raises:
            StateError: the disk cannot be written; the caller must not start the action.
        """
        with self._guard:
            body = {"v": JOURNAL_FORMAT, "at": format_instant(self.clock()), "event": event, **fields}
            line, digest = _encode_line(body, self._last)
            try:
                _write_all(self._descriptor, line)
                hit_failpoint("intent written")
                os.fsync(self._descriptor)
            except OSError as error:
                raise StateError(
                    f"cannot write {self.path}: {error.strerror}",
                    hint="free some space; no action was started without a record",
                ) from error
            self._last = digest
        hit_failpoint(f"{event} fsynced")
        self.on_append(body)

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


def _encode_line(body: JournalEntry, previous: str) -> tuple[bytes, str]:
    text = json.dumps(body, ensure_ascii=True, allow_nan=False, separators=(",", ":"), sort_keys=True)
    digest = hashlib.sha256((previous + text).encode()).hexdigest()
    return f"{digest} {text}\n".encode(), digest
