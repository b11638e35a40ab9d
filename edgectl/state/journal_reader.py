# SPDX-License-Identifier: Apache-2.0
"""Verification and summary of a journal, line by line, so that a long one needs little memory."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import field
from functools import lru_cache
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.errors import StateError

JOURNAL_FORMAT = 1
GENESIS_HASH = "0" * 64
JournalEntry = Mapping[str, object]


@dataclass(slots=True, kw_only=True)
class JournalSummary:
    """Summary of a journal: its state without the entries, the hash of the last one, and the end of its valid
    part.

    ``revision``: number of the newest apply, 0 if none. ``begun``: ids of the plans that this file records as
    applied; ``known``: these, those of the earlier files and those of other machines, in order.
    ``generations``: the highest generation that a start of
    each task may have used: that of its intent, and one more for a restored instance. ``located``: host and
    generation of each task that was or may have been started since the manager's state was last saved.
    ``doubtful``: the same of each task that was or may have been started beside an old instance of which
    nobody knows whether it still runs.
    ``size``: bytes of valid lines. ``torn``: bytes of an unfinished last line. ``broken``: number of the
    first damaged line, 0 if none.
    """

    revision: int = 0
    begun: set[str] = field(default_factory=set)
    known: dict[str, None] = field(default_factory=dict)
    generations: dict[str, int] = field(default_factory=dict)
    located: dict[str, tuple[str, int]] = field(default_factory=dict)
    doubtful: dict[str, tuple[str, int]] = field(default_factory=dict)
    last: str = GENESIS_HASH
    size: int = 0
    torn: int = 0
    broken: int = 0
    _intended: dict[str, int] = field(default_factory=dict)
    _leaving: dict[str, str] = field(default_factory=dict)
    _unfinished: dict[str, None] = field(default_factory=dict)
    _held: dict[str, None] = field(default_factory=dict)
    _spooled: dict[str, dict[str, None]] = field(default_factory=dict)

    @property
    def applied(self) -> set[str]:
        """Ids of all plans recorded as applied, earlier files included."""
        return set(self.known)

    @property
    def unfinished(self) -> tuple[str, ...]:
        """Tasks with an action in progress when the newest apply was interrupted.

        Empty if it ended properly.
        """
        return tuple(self._unfinished)

    @property
    def held(self) -> tuple[str, ...]:
        """Tasks whose robot was put on hold for a handoff without a recorded release."""
        return tuple(self._held)

    @property
    def spooled(self) -> dict[str, tuple[str, ...]]:
        """Hosts that may still keep the state of a task for a move, by task."""
        return {task: tuple(hosts) for task, hosts in self._spooled.items()}

    @property
    def sound(self) -> bool:
        """Whether nothing is torn, damaged, interrupted or left on hosts, and no robot is on hold."""
        return not (self._unfinished or self._held or self._spooled or self.torn or self.broken)

    def take(self, entry: JournalEntry) -> None:
        """Add one entry."""
        event, task = entry.get("event"), str(entry.get("task"))
        if isinstance(revision := entry.get("revision"), int):
            self.revision = max(self.revision, revision)
        if event == "begin":
            self.begun.add(str(entry.get("plan")))
            self.known[str(entry.get("plan"))] = None
        elif event in ("continued", "handover"):
            self._take_earlier(entry)
        elif event in ("intent", "copy"):
            self._take_intent(event, task, entry)
        elif event == "phase":
            self._take_phase(task, entry)
        elif event == "commit":
            self._take_commit(task, entry)
        elif event in ("released", "dropped"):
            (self._held if event == "released" else self._spooled).pop(task, None)
        if event in ("end", "recovered"):
            self._unfinished.clear()
        if event in ("placed", "recovered"):
            self.located.clear()
            self.doubtful = _read_starts(entry.get("doubtful"))

    def _take_earlier(self, entry: JournalEntry) -> None:
        """The plans of earlier files or other machines, put last. With a ``handover`` also what another
        machine has left open, in place of what this one had.
        """
        for name in _read_names(entry.get("applied")):
            self.known.pop(name, None)
            self.known[name] = None
        if entry.get("event") == "handover":
            spooled = entry.get("spooled")
            self._unfinished = dict.fromkeys(_read_names(entry.get("unfinished")))
            self._held = dict.fromkeys(_read_names(entry.get("held")))
            self._spooled = {
                str(task): dict.fromkeys(_read_names(hosts))
                for task, hosts in (spooled.items() if isinstance(spooled, dict) else ())
            }

    def _take_intent(self, event: object, task: str, entry: JournalEntry) -> None:
        """An action, or an inactive copy: nothing is unfinished where that is interrupted."""
        if event == "intent":
            self._unfinished[task] = None
            self._leaving.pop(task, None)
            if entry.get("action") == "move":
                self._leaving[task] = str(entry.get("previous_host"))
        generation = entry.get("generation")
        if isinstance(generation, int):
            self._intended[task] = generation
            self.generations[task] = max(self.generations.get(task, 0), generation + 1)

    def _take_phase(self, task: str, entry: JournalEntry) -> None:
        phase, host = entry.get("phase"), str(entry.get("host"))
        if phase == "hold":
            self._held[task] = None
        elif phase in ("save", "transfer"):
            self._spooled.setdefault(task, {})[host] = None
        elif phase == "stop" and task not in self.doubtful and self._leaving.get(task) == host:
            del self._leaving[task]  # what starts later in this action starts after the proof of this stop
        elif phase in ("start", "activate", "restore"):
            start = (host, self._intended.get(task, 0) + (phase == "restore"))
            beside = task in self._leaving and phase != "restore"
            (self.doubtful if beside else self.located)[task] = start
            if not beside:
                self.doubtful.pop(task, None)

    def _take_commit(self, task: str, entry: JournalEntry) -> None:
        located = entry.get("located")
        self._unfinished.pop(task, None)
        doubted = self.doubtful.get(task)
        if doubted is not None and (located == doubted[0] or _is_withdrawn(entry, doubted[0])):
            del self.doubtful[task]
            if located == doubted[0]:
                self.located[task] = doubted
            return
        started = self.located.pop(task, None)
        if started is not None and isinstance(located, str):
            self.located[task] = (located, started[1])


def _is_withdrawn(entry: JournalEntry, host: str) -> bool:
    """Whether what an action started on ``host`` is proven not to run: stopped since, or never activated."""
    found, withdrawn = entry.get("phases"), True
    for each in found if isinstance(found, list) else []:
        if isinstance(each, dict) and each.get("host") == host:
            if each.get("phase") == "start":
                withdrawn = False
            elif each.get("phase") == "stop" and each.get("ok") is True:
                withdrawn = True
    return withdrawn


def _read_starts(value: object) -> dict[str, tuple[str, int]]:
    found = value.items() if isinstance(value, dict) else ()
    return {
        str(task): (str(start[0]), start[1])
        for task, start in found
        if isinstance(start, list) and len(start) == 2 and isinstance(start[1], int)
    }


def _read_names(value: object) -> tuple[str, ...]:
    return tuple(map(str, value)) if isinstance(value, list) else ()


def read_journal(path: Path, take: Callable[[JournalEntry], None] | None = None) -> JournalSummary:
    """Read and verify a journal and pass each entry to ``take``; a missing file is an empty journal.

    Raises:
        StateError: it cannot be read, or a newer edgectl wrote it.
    """
    log = JournalSummary()
    try:
        with path.open("rb") as file:
            for number, line in enumerate(file, 1):
                if not line.endswith(b"\n"):
                    log.torn = len(line)
                    break  # a writer may be appending; what follows is not a line yet
                _read_line(path, log, number, line[:-1], take)
    except FileNotFoundError:
        return log
    except OSError as error:
        raise StateError(f"cannot read {path}: {error.strerror}") from error
    return log


def _read_line(
    path: Path, log: JournalSummary, number: int, line: bytes, take: Callable[[JournalEntry], None] | None
) -> None:
    digest, entry = _decode_line(line)
    sound = hashlib.sha256(log.last.encode() + line[65:]).hexdigest() == digest
    if sound and entry.get("v") != JOURNAL_FORMAT:
        raise StateError(
            f"{path} was written by a newer edgectl (format {entry.get('v')})",
            hint="use that edgectl, or move the file away",
        )
    if not sound and not log.broken:
        log.broken = number
    log.last, log.size = digest, log.size + len(line) + 1
    if entry:
        log.take(entry)
        if take is not None:
            take(entry)


def read_journal_cached(path: Path) -> JournalSummary:
    """`read_journal` with a cache, renewed when the file changes: a watch asks in every cycle. Do not modify
    the result.

    Raises:
        StateError: as `read_journal`.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        return JournalSummary()
    except OSError as error:
        raise StateError(f"cannot read {path}: {error.strerror}") from error
    return _read_journal_version(path, (found.st_ino, found.st_size, found.st_mtime_ns))


@lru_cache(maxsize=4)
def _read_journal_version(path: Path, _stamp: tuple[int, int, int]) -> JournalSummary:
    return read_journal(path)


def _decode_line(line: bytes) -> tuple[str, JournalEntry]:
    """Digest and entry of one line; the entry is empty if it cannot be parsed."""
    try:
        text = line.decode("ascii")
        entry = json.loads(text[65:])
    except (ValueError, RecursionError):
        return "", {}
    return text[:65].removesuffix(" "), entry if isinstance(entry, dict) else {}
