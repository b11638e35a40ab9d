# SPDX-License-Identifier: Apache-2.0
"""What is seen of a fleet on its hosts while it is broken: who is granted the fleet, what starts, and what stops.

Reads the records that hosts keep (two versions of each, numbered), and shares no code with edgectl. The hosts are
looked at one after the other, which takes long on a busy machine: what may have happened in another order than it was
seen stands together. A grant of which no look saw the record is a gap: epochs are counted.
"""

import json
import threading
import time
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

SLOT_BYTES = 2048
PAUSE_S = 0.001
# States of the record of a task of which an instance may live.
LIVING = frozenset({"starting", "running", "ready", "unhealthy"})


@dataclass(frozen=True, kw_only=True, order=True)
class Event:
    """``kind``: grant (to a session), start or stop (of a task)."""

    kind: str
    host: str
    session: str = ""
    holder: str = ""
    manager: str = ""
    revision: int = 0
    task: str = ""


Group = tuple[frozenset[Event], float]
"""Events of which no order is known, and when the last of them was seen."""


def add_events(groups: list[Group], events: frozenset[Event], after: float, until: float) -> None:
    """Add what happened on a host between its look ``after`` and now: together with all that was seen since then
    elsewhere, which may be later. What happened twice stays apart.
    """
    while groups and after < groups[-1][1] and not events & groups[-1][0]:
        earlier, seen = groups.pop()
        events, until = events | earlier, max(until, seen)
    groups.append((events, until))


@dataclass(kw_only=True)
class Recorder:
    """Looks at the hosts until it is told to end. ``homes``: host -> its home directory."""

    homes: Mapping[str, Path]
    fleet: str
    groups: list[Group] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)
    instances: set[str] = field(default_factory=set)
    _seen: dict[Path, int] = field(default_factory=dict)
    _epochs: dict[str, int] = field(default_factory=dict)
    _living: dict[tuple[str, str], str] = field(default_factory=dict)
    _bases: dict[str, Path] = field(default_factory=dict)
    _looked: dict[str, float] = field(default_factory=dict)
    _over: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Look again and again; the last look is after the end."""
        last = False
        while not last:
            last = self._over.wait(PAUSE_S)
            for host, home in self.homes.items():
                began = time.monotonic()
                if events := frozenset(self._look(host, home)):
                    add_events(self.groups, events, self._looked.get(host, began), time.monotonic())
                self._looked[host] = began

    @property
    def looks(self) -> list[frozenset[Event]]:
        """What was seen, in its order: what stands together may have happened in any order."""
        return [events for events, _ in self.groups]

    def __enter__(self) -> "Recorder":
        self._thread = threading.Thread(target=self.run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """Look once more, and end."""
        self._over.set()
        self._thread.join()

    def _look(self, host: str, home: Path) -> Iterator[Event]:
        base = self._bases.get(host) or next(home.glob(f"**/agent-state/{self.fleet}"), None)
        if base is not None:
            self._bases[host] = base
            yield from self._look_at_lease(host, base / "lease")
            for path in sorted(base.glob("hosts/*/tasks/*/status")):
                yield from self._look_at_task(host, path)

    def _look_at_lease(self, host: str, path: Path) -> Iterator[Event]:
        for document in self._read_new(path):
            last, epoch = self._epochs.get(host, 0), int(str(document["epoch"]))
            if epoch == last:
                continue
            if epoch > last + 1:
                self.gaps.append(f"{host}: epochs {last + 1} to {epoch - 1}")
            self._epochs[host] = epoch
            term = document.get("term") or ["", 0]
            assert isinstance(term, list)
            yield Event(
                kind="grant",
                host=host,
                session=str(document["session"]),
                holder=str(document["holder"]),
                manager=str(document["manager"]),
                revision=int(term[1]) if term[0] == document["holder"] else 0,
            )

    def _look_at_task(self, host: str, path: Path) -> Iterator[Event]:
        key = (host, path.parent.name)
        for document in self._read_new(path):
            instance, lives = str(document["instance"]), document.get("state") in LIVING
            before = self._living.get(key)
            if before is not None and (before != instance or not lives):
                del self._living[key]
                yield Event(kind="stop", host=host, task=key[1])
            if lives and before != instance:
                self._living[key] = instance
                self.instances.add(instance)
                yield Event(kind="start", host=host, task=key[1])

    def _read_new(self, path: Path) -> list[dict[str, object]]:
        """The versions that were not seen before, in their order."""
        try:
            data = path.read_bytes()
        except OSError:
            return []
        versions = sorted(
            version for at in (0, SLOT_BYTES) if (version := read_slot(data[at : at + SLOT_BYTES]))
        )
        last = self._seen.get(path, 0)
        new = [(number, text) for number, text in versions if number > last]
        if new:
            self._seen[path] = new[-1][0]
        return [json.loads(text) for _, text in new]


def read_slot(data: bytes) -> tuple[int, str] | None:
    """Number and text of one version: ``sequence crc32 json``; None where it is being written."""
    words = data.rstrip(b" \0").split(b" ", 2)
    if len(words) < 3:
        return None
    try:
        number, checksum = int(words[0]), int(words[1], 16)
    except ValueError:
        return None
    return (number, words[2].decode()) if zlib.crc32(words[0] + words[2]) == checksum else None


def format_observed(looks: list[frozenset[Event]]) -> tuple[str, dict[str, int]]:
    """The module Observed of docs/model/FleetTrace.tla, and how many of each there are."""
    grants = sorted({each for look in looks for each in look if each.kind == "grant"})
    first = {each.session: at for at, look in reversed([*enumerate(looks)]) for each in look if each.session}
    order = {each.session: (each.revision, first[each.session]) for each in grants}
    sessions = sorted(order, key=lambda session: order[session])
    manager_of = {each.session: each.manager for each in grants}
    managers = _number(manager_of[session] for session in sessions)
    tasks = _number(each.task for look in looks for each in sorted(look) if each.task)
    hosts = _number(each.host for look in looks for each in sorted(look))
    lines = []
    for look in looks:
        events = []
        for each in sorted(look):
            where = f"host |-> h{hosts[each.host]}"
            if each.kind == "grant":
                events.append(f'[kind |-> "grant", {where}, run |-> {sessions.index(each.session) + 1}]')
            else:
                events.append(f'[kind |-> "{each.kind}", {where}, task |-> t{tasks[each.task]}]')
        lines.append("  {" + ", ".join(events) + "}")
    names = [
        f"{letter}{number + 1}"
        for letter, of in (("m", managers), ("h", hosts), ("t", tasks))
        for number in range(len(of))
    ]
    owners = ", ".join(f"m{managers[manager_of[session]]}" for session in sessions)
    text = "\n".join(
        [
            "---- MODULE Observed ----",
            "EXTENDS Naturals",
            f"CONSTANTS {', '.join(names)}",
            f"Owners == <<{owners}>>",
            "Trace == <<",
            ",\n".join(lines),
            ">>",
            "====",
        ]
    )
    counts = {"managers": len(managers), "hosts": len(hosts), "tasks": len(tasks), "runs": len(sessions)}
    return text + "\n", counts


def _number(names: "Iterator[str]") -> dict[str, int]:
    found: dict[str, int] = {}
    for name in names:
        found.setdefault(name, len(found) + 1)
    return found
