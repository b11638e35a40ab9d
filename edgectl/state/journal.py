"""What this manager did to the fleet: append-only lines, each with a checksum chained to the line before, synced before it counts.

The journal is also the one source of the revision number and of the plans that were applied already.
"""

import hashlib
import json
import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Self

from edgectl.errors import StateError
from edgectl.state.files import Warn, set_aside, silent
from edgectl.state.paths import open_private
from edgectl.state.points import reached
from edgectl.units import format_instant

FORMAT = 1
NAME = "journal.jsonl"
# About five hundred applies: every apply reads it whole.
_LONG = 1 << 20
_GENESIS = "0" * 64
Entry = Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Log:
    """A journal as read: its entries, the hash of the last one, and where it stops being sound.

    ``size``: bytes of sound lines. ``torn``: bytes of an unfinished last line. ``broken``: number of the first damaged line, 0 if none.
    """

    entries: tuple[Entry, ...] = ()
    last: str = _GENESIS
    size: int = 0
    torn: int = 0
    broken: int = 0

    @property
    def revision(self) -> int:
        """Number of the newest apply, 0 where there was none."""
        return max((value for entry in self.entries if isinstance(value := entry.get("revision"), int)), default=0)

    @property
    def begun(self) -> frozenset[str]:
        """Ids of the plans that this file saw applied."""
        return frozenset(str(entry.get("plan")) for entry in self.entries if entry.get("event") == "begin")

    @property
    def applied(self) -> frozenset[str]:
        """Ids of the plans that this file and the one before saw applied."""
        kept = (entry.get("applied") for entry in self.entries if entry.get("event") == "continued")
        return self.begun | {str(name) for names in kept if isinstance(names, list) for name in names}

    @property
    def unfinished(self) -> tuple[str, ...]:
        """Tasks whose action had begun when the newest apply was cut off; empty where it ended properly."""
        open_tasks: dict[str, None] = {}
        for entry in self.entries:
            event, task = entry.get("event"), str(entry.get("task"))
            if event in ("end", "recovered"):
                open_tasks.clear()
            elif event == "intent":
                open_tasks[task] = None
            elif event == "commit":
                open_tasks.pop(task, None)
        return tuple(open_tasks)

    @property
    def generations(self) -> dict[str, int]:
        """The highest generation that a start of each task may have had: that of its intent, and one more for a restored instance."""
        found: dict[str, int] = {}
        for entry in self.entries:
            generation = entry.get("generation")
            if entry.get("event") == "intent" and isinstance(generation, int):
                task = str(entry.get("task"))
                found[task] = max(found.get(task, 0), generation + 1)
        return found

    @property
    def located(self) -> dict[str, tuple[str, int]]:
        """Host and generation of each task that was, or may have been, started since the memory was last saved."""
        found: dict[str, tuple[str, int]] = {}
        generations: dict[str, int] = {}
        for entry in self.entries:
            event, task, generation = entry.get("event"), str(entry.get("task")), entry.get("generation")
            if event in ("placed", "recovered"):
                found.clear()
            elif event == "intent" and isinstance(generation, int):
                generations[task] = generation
            elif event == "phase" and entry.get("phase") in ("start", "restore"):
                found[task] = (str(entry.get("host")), generations.get(task, 0) + (entry.get("phase") == "restore"))
            elif event == "commit" and task in found:
                started = found.pop(task)
                if isinstance(entry.get("located"), str):
                    found[task] = (str(entry["located"]), started[1])
        return found

    @property
    def held(self) -> tuple[str, ...]:
        """Tasks whose robot was told to hold for a handoff, and of which no release is known."""
        held: dict[str, None] = {}
        for entry in self.entries:
            task = str(entry.get("task"))
            if entry.get("event") == "phase" and entry.get("phase") == "hold":
                held[task] = None
            elif entry.get("event") == "released":
                held.pop(task, None)
        return tuple(held)


@dataclass(slots=True)
class Journal:
    """The open journal of one fleet; safe to append to from several threads. Open it while holding the fleet's lock."""

    path: Path
    log: Log
    clock: Callable[[], float]
    _descriptor: int
    _last: str
    _guard: threading.Lock = field(default_factory=threading.Lock)

    @classmethod
    def open(cls, fleet_dir: Path, *, clock: Callable[[], float] = time.time, warn: Warn = silent) -> Self:
        """Open for appending. A torn last line is cut off and recorded; a damaged file is set aside and a new one begun.

        A long file is put away as ``journal-REVISION.jsonl``; the new one begins with the hash of its last line.

        Raises:
            StateError: a newer edgectl wrote it, or the disk does not take it.
        """
        path = fleet_dir / NAME
        log = read(path)
        salvaged = log
        if log.broken:
            warn(f"{path} is damaged at line {log.broken}; set aside as {set_aside(path).name}")
            log = Log()
        elif log.size > _LONG and not (log.unfinished or log.held or log.torn):
            path.rename(path.with_name(f"journal-{log.revision}.jsonl"))
            log = Log()
        journal = cls(path=path, log=salvaged, clock=clock, _descriptor=open_private(path, os.O_WRONLY | os.O_APPEND), _last=log.last)
        if log.torn:
            os.ftruncate(journal._descriptor, log.size)
            warn(f"{path}: an unfinished last line ({log.torn} bytes) was cut off; the action it announced never began")
            journal.append("torn", bytes=log.torn)
        if log is not salvaged:
            applied = salvaged.applied if salvaged.broken else salvaged.begun
            journal.append("continued", revision=salvaged.revision, applied=sorted(applied), after=salvaged.last)
        return journal

    def append(self, event: str, **fields: object) -> None:
        """Write one entry and wait until the disk has it.

        Raises:
            StateError: the disk does not take it; the caller must not go on to the side effect.
        """
        with self._guard:
            body = {"v": FORMAT, "at": format_instant(self.clock()), "event": event, **fields}
            line, digest = _line(body, self._last)
            try:
                _write_all(self._descriptor, line)
                reached("intent written")
                os.fsync(self._descriptor)
            except OSError as error:
                raise StateError(
                    f"cannot write {self.path}: {error.strerror}", hint="free some space; nothing was done without a record"
                ) from error
            self._last = digest
        reached(f"{event} fsynced")

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


def _line(body: Entry, previous: str) -> tuple[bytes, str]:
    text = json.dumps(body, ensure_ascii=True, allow_nan=False, separators=(",", ":"), sort_keys=True)
    digest = hashlib.sha256((previous + text).encode()).hexdigest()
    return f"{digest} {text}\n".encode(), digest


def read(path: Path) -> Log:
    """Read and verify a journal; a missing file is an empty one.

    Raises:
        StateError: it cannot be read, or a newer edgectl wrote it.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return Log()
    except OSError as error:
        raise StateError(f"cannot read {path}: {error.strerror}") from error
    *lines, rest = data.split(b"\n")
    return _verified(path, lines, torn=len(rest))


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """What a look at the fleet needs of a journal, as in `Log`. ``sound``: nothing is torn or damaged, nothing cut off, nobody held."""

    located: Mapping[str, tuple[str, int]]
    sound: bool


def standing(path: Path) -> Standing:
    """How a journal stands. Read anew only where the file changed: a watch asks in every cycle.

    Raises:
        StateError: as `read`.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        return Standing(located={}, sound=True)
    except OSError as error:
        raise StateError(f"cannot read {path}: {error.strerror}") from error
    return _standing(path, (found.st_ino, found.st_size, found.st_mtime_ns))


@lru_cache(maxsize=4)
def _standing(path: Path, _stamp: tuple[int, int, int]) -> Standing:
    log = read(path)
    return Standing(located=log.located, sound=not (log.unfinished or log.held or log.torn or log.broken))


def _verified(path: Path, lines: Iterable[bytes], *, torn: int) -> Log:
    entries: list[Entry] = []
    last, size, broken = _GENESIS, 0, 0
    for number, line in enumerate(lines, 1):
        digest, entry = _decoded(line)
        sound = hashlib.sha256(last.encode() + line[65:]).hexdigest() == digest
        if sound and entry.get("v") != FORMAT:
            raise StateError(
                f"{path} was written by a newer edgectl (format {entry.get('v')})", hint="use that edgectl, or move the file away"
            )
        if not sound and not broken:
            broken = number
        if entry and (sound or broken):
            entries.append(entry)
        last, size = digest, size + len(line) + 1
    return Log(entries=tuple(entries), last=last, size=size, torn=torn, broken=broken)


def _decoded(line: bytes) -> tuple[str, Entry]:
    """The digest and the entry of one line; an empty entry where it cannot be read."""
    try:
        text = line.decode("ascii")
        entry = json.loads(text[65:])
    except (ValueError, RecursionError):
        return "", {}
    return text[:65].removesuffix(" "), entry if isinstance(entry, dict) else {}
