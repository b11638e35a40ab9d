# SPDX-License-Identifier: Apache-2.0
"""Independent oracle: judges by the records of the test tasks and by the kernel, not by edgectl's output.

Shares no code with the product; standard library only. Times are nanoseconds of CLOCK_BOOTTIME, which all
namespaces of one machine share. A *launch* is one start of a task with all its processes; its *lifetime*
reaches from the first to the last line that any of them wrote. Both ends prove that the task was alive: an
overlap of two lifetimes is never an artefact of a slow machine.
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


def read_boottime_ns() -> int:
    """Return the present time of the records' clock in nanoseconds."""
    return time.clock_gettime_ns(BOOTTIME)


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchLifetime:
    """One launch of a task: host, task, first and last record, whether it reported its end, its processes and
    signals.
    """

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
class Overlap:
    """Two launches of one task that were alive at the same time for ``ns`` nanoseconds."""

    task: str
    first: LaunchLifetime
    second: LaunchLifetime
    ns: int


def read_events(path: Path) -> list[dict[str, object]]:
    """Return the lines of one record file, without a line cut short by a power loss."""
    events = []
    for line in path.read_bytes().split(b"\n"):
        try:
            event = json.loads(line)
        except ValueError:
            continue
        if isinstance(event, dict) and isinstance(event.get("ns"), int):
            events.append(event)
    return events


def _lifetime_from_events(host: str, events: list[dict[str, object]]) -> LaunchLifetime:
    times = [int(str(event["ns"])) for event in events]
    main = [event for event in events if event["role"] == "main"] or events
    kinds = [str(event["event"]) for event in events]
    return LaunchLifetime(
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


def list_lifetimes(records: Mapping[str, Path]) -> list[LaunchLifetime]:
    """Return every launch in the record directories (by host name), sorted by start."""
    found = []
    for host, directory in records.items():
        launches: dict[str, list[dict[str, object]]] = defaultdict(list)
        for path in sorted(directory.glob("*.jsonl")):
            for event in read_events(path):
                if "launch" in event:
                    launches[str(event["launch"])].append(event)
        found += [_lifetime_from_events(host, events) for events in launches.values()]
    return sorted(found, key=lambda life: life.first_ns)


def read_counts(directory: Path, launch: str) -> list[int]:
    """Return what the launch knew at each of its lines, if its task counts (`standby_task`)."""
    return [
        int(str(event["count"]))
        for path in sorted(directory.glob(f"{launch}.*.jsonl"))
        for event in read_events(path)
        if "count" in event
    ]


def group_by_task(all_lives: Iterable[LaunchLifetime]) -> dict[str, list[LaunchLifetime]]:
    """Group launches by task."""
    tasks: dict[str, list[LaunchLifetime]] = defaultdict(list)
    for life in all_lives:
        tasks[life.task].append(life)
    return dict(tasks)


def find_overlaps(all_lives: Iterable[LaunchLifetime], allowed: Iterable[str] = ()) -> list[Overlap]:
    """Return every pair of launches of one task that overlapped, except for tasks whose launches may overlap."""
    spared = set(allowed)
    found = []
    for task, launches in group_by_task(all_lives).items():
        for first, second in combinations(launches, 2):
            shared = min(first.last_ns, second.last_ns) - max(first.first_ns, second.first_ns)
            if shared >= 0 and task not in spared:
                found.append(Overlap(task=task, first=first, second=second, ns=shared))
    return found


def compute_longest_overlap(all_lives: Iterable[LaunchLifetime]) -> float:
    """Return the longest overlap of two launches of one task in seconds, 0 without overlap."""
    return max((clash.ns for clash in find_overlaps(all_lives)), default=0) / SECOND


def compute_longest_gap(launches: Iterable[LaunchLifetime]) -> float:
    """Return the longest time in seconds without any of these launches (of one task), between the first and
    the last.
    """
    gap, until = 0, None
    for life in sorted(launches, key=lambda life: life.first_ns):
        if until is not None:
            gap = max(gap, life.first_ns - until)
        until = max(until or 0, life.last_ns)
    return gap / SECOND


def count_alive_at(all_lives: Iterable[LaunchLifetime], ns: int) -> dict[str, int]:
    """Count the launches of each task that were alive at one moment."""
    count: dict[str, int] = defaultdict(int)
    for life in all_lives:
        count[life.task] += life.first_ns <= ns <= life.last_ns
    return dict(count)


def count_most_alive(launches: Iterable[LaunchLifetime]) -> int:
    """Return the greatest number of launches alive at the same time."""
    marks = sorted([(life.first_ns, 0) for life in launches] + [(life.last_ns, 1) for life in launches])
    now = most = 0
    for _, end in marks:
        now += -1 if end else 1
        most = max(most, now)
    return most


def watch_launches(
    records: Mapping[str, Path], *, seconds: float = 1.0, patience: float = 0.0, expected: Iterable[str] = ()
) -> dict[str, list[LaunchLifetime]]:
    """Return the launches of each task that still write after ``seconds``.

    Watches up to ``patience`` more seconds while one of the ``expected`` tasks is missing: a starved machine
    may have kept it from writing. Seconds are counted in short sleeps, so that a stall of the whole machine
    counts as one sleep.
    """
    wanted, deadline = set(expected), time.monotonic() + patience
    while True:
        begun = read_boottime_ns()
        for _ in range(max(1, round(seconds / TURN_S))):
            time.sleep(TURN_S)
        found = group_by_task(life for life in list_lifetimes(records) if life.last_ns > begun)
        if not wanted - set(found) or time.monotonic() >= deadline:
            return found


@dataclass(frozen=True, slots=True, kw_only=True)
class OracleVerdict:
    """Violations, one sentence each; no violation means a clean verdict."""

    lost: tuple[str, ...] = ()
    doubled: tuple[str, ...] = ()
    foreign: tuple[str, ...] = ()
    left: tuple[str, ...] = ()

    @property
    def clean(self) -> bool:
        return not (self.lost or self.doubled or self.foreign or self.left)

    def __str__(self) -> str:
        return "; ".join(self.lost + self.doubled + self.foreign + self.left) or "clean"


def judge_launches(
    records: Mapping[str, Path],
    expected: Mapping[str, str | None],
    *,
    since_ns: int = 0,
    overlap_allowed: Iterable[str] = (),
    seconds: float = 1.0,
    patience: float = 5.0,
) -> OracleVerdict:
    """Check for exactly one launch of each ``expected`` task (on that host; None: anywhere), no other task,
    and no overlap since ``since_ns``.
    """
    alive = watch_launches(records, seconds=seconds, patience=patience, expected=expected)
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
    recent = [life for life in list_lifetimes(records) if life.last_ns >= since_ns]
    doubled += [
        f"{clash.task} overlapped for {clash.ns / SECOND:.3f} s ({clash.first.host} {clash.first.launch}, {clash.second.host} {clash.second.launch})"
        for clash in find_overlaps(recent, overlap_allowed)
    ]
    return OracleVerdict(lost=tuple(lost), doubled=tuple(doubled))
