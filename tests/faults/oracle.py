"""The judge: reads what the test tasks wrote about themselves and what the kernel says, never what the product says.

Shares no code with the product and needs the standard library only. Times are nanoseconds of CLOCK_BOOTTIME, which all namespaces
of one machine share. A *launch* is one start of a task with all processes that came of it; its *life* reaches from the first to the
last line that any of them wrote. Two ends of a life are therefore both proof that the task lived: an overlap of two lives is never an
artefact of a slow machine.
"""

import json
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

BOOTTIME = 7
SECOND = 1_000_000_000
TURN_S = 0.05


def now_ns() -> int:
    """The clock of the records."""
    return time.clock_gettime_ns(BOOTTIME)


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """One launch of a task: where, who, from when to when, whether it ended by its own word, and how many processes it had."""

    task: str
    host: str
    launch: str
    cookie: str
    pids: tuple[int, ...]
    first_ns: int
    last_ns: int
    stopped: bool
    signals: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Clash:
    """Two launches of one task that lived at the same time for ``ns``."""

    task: str
    first: Life
    second: Life
    ns: int


def read_events(path: Path) -> list[dict[str, object]]:
    """The lines of one record; a line cut short by a power loss is left out."""
    events = []
    for line in path.read_bytes().split(b"\n"):
        try:
            event = json.loads(line)
        except ValueError:
            continue
        if isinstance(event, dict) and isinstance(event.get("ns"), int):
            events.append(event)
    return events


def _life(host: str, events: list[dict[str, object]]) -> Life:
    times = [int(str(event["ns"])) for event in events]
    main = [event for event in events if event["role"] == "main"] or events
    kinds = [str(event["event"]) for event in events]
    return Life(
        task=str(main[0]["task"]),
        host=host,
        launch=str(main[0]["launch"]),
        cookie=str(main[0]["cookie"]),
        pids=tuple(sorted({int(str(event["pid"])) for event in events})),
        first_ns=min(times),
        last_ns=max(times),
        stopped="stop" in kinds,
        signals=tuple(kind for kind in kinds if kind.startswith("SIG")),
    )


def lives(records: Mapping[str, Path]) -> list[Life]:
    """Every launch in the record directories (by host name), in the order of their beginnings."""
    found = []
    for host, directory in records.items():
        launches: dict[str, list[dict[str, object]]] = defaultdict(list)
        for path in sorted(directory.glob("*.jsonl")):
            for event in read_events(path):
                if "launch" in event:
                    launches[str(event["launch"])].append(event)
        found += [_life(host, events) for events in launches.values()]
    return sorted(found, key=lambda life: life.first_ns)


def by_task(all_lives: Iterable[Life]) -> dict[str, list[Life]]:
    """The launches of each task."""
    tasks: dict[str, list[Life]] = defaultdict(list)
    for life in all_lives:
        tasks[life.task].append(life)
    return dict(tasks)


def clashes(all_lives: Iterable[Life], allowed: Iterable[str] = ()) -> list[Clash]:
    """Every pair of launches of one task that lived at the same time, save for the tasks whose launches may overlap."""
    spared = set(allowed)
    found = []
    for task, launches in by_task(all_lives).items():
        for first, second in combinations(launches, 2):
            shared = min(first.last_ns, second.last_ns) - max(first.first_ns, second.first_ns)
            if shared >= 0 and task not in spared:
                found.append(Clash(task=task, first=first, second=second, ns=shared))
    return found


def longest_overlap(all_lives: Iterable[Life]) -> float:
    """Seconds for which two launches of one task lived together at most; 0 where none did."""
    return max((clash.ns for clash in clashes(all_lives)), default=0) / SECOND


def longest_gap(launches: Iterable[Life]) -> float:
    """Seconds in which none of these launches (of one task) lived, at most, between the first and the last of them."""
    gap, until = 0, None
    for life in sorted(launches, key=lambda life: life.first_ns):
        if until is not None:
            gap = max(gap, life.first_ns - until)
        until = max(until or 0, life.last_ns)
    return gap / SECOND


def live_at(all_lives: Iterable[Life], ns: int) -> dict[str, int]:
    """How many launches of each task lived at that moment."""
    count: dict[str, int] = defaultdict(int)
    for life in all_lives:
        count[life.task] += life.first_ns <= ns <= life.last_ns
    return dict(count)


def most_live(launches: Iterable[Life]) -> int:
    """How many of these launches lived at one moment, at most."""
    marks = sorted([(life.first_ns, 0) for life in launches] + [(life.last_ns, 1) for life in launches])
    now = most = 0
    for _, end in marks:
        now += -1 if end else 1
        most = max(most, now)
    return most


def watch(
    records: Mapping[str, Path], *, seconds: float = 1.0, patience: float = 0.0, expected: Iterable[str] = ()
) -> dict[str, list[Life]]:
    """The launches of each task that still write after ``seconds`` of watching.

    It is looked again for up to ``patience`` more seconds while one of the ``expected`` tasks does not show: a starved machine may not
    have let it write yet. The seconds are counted in short turns, so that a machine that stands still for all of them counts as one turn.
    """
    wanted, deadline = set(expected), time.monotonic() + patience
    while True:
        begun = now_ns()
        for _ in range(max(1, round(seconds / TURN_S))):
            time.sleep(TURN_S)
        found = by_task(life for life in lives(records) if life.last_ns > begun)
        if not wanted - set(found) or time.monotonic() >= deadline:
            return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What is wrong, each as a sentence; nothing anywhere means innocent."""

    lost: tuple[str, ...] = ()
    doubled: tuple[str, ...] = ()
    foreign: tuple[str, ...] = ()
    left: tuple[str, ...] = ()

    @property
    def clean(self) -> bool:
        return not (self.lost or self.doubled or self.foreign or self.left)

    def __str__(self) -> str:
        return "; ".join(self.lost + self.doubled + self.foreign + self.left) or "clean"


def judge(
    records: Mapping[str, Path],
    expected: Mapping[str, str | None],
    *,
    since_ns: int = 0,
    overlap_allowed: Iterable[str] = (),
    seconds: float = 1.0,
    patience: float = 5.0,
) -> Verdict:
    """Exactly one launch of each ``expected`` task (on that host; None: anywhere), none of any other, and no clash since ``since_ns``."""
    alive = watch(records, seconds=seconds, patience=patience, expected=expected)
    lost = [f"{task} does not run" for task in expected if task not in alive]
    doubled = [
        f"{task} runs {len(found)} times: {[life.host for life in found]}"
        for task, found in alive.items()
        if len(found) > 1
    ]
    doubled += [
        f"{task} runs on {found[0].host} and should not"
        for task, found in alive.items()
        if task not in expected
    ]
    lost += [
        f"{task} runs on {alive[task][0].host}, not on {host}"
        for task, host in expected.items()
        if host and task in alive and host not in {life.host for life in alive[task]}
    ]
    recent = [life for life in lives(records) if life.last_ns >= since_ns]
    doubled += [
        f"{clash.task} overlapped for {clash.ns / SECOND:.3f} s ({clash.first.host} {clash.first.launch}, {clash.second.host} {clash.second.launch})"
        for clash in clashes(recent, overlap_allowed)
    ]
    return Verdict(lost=tuple(lost), doubled=tuple(doubled))
