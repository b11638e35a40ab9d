"""The list of faults, how one is injected, and the table of what came of it.

A fault is one function: it brings the fleet into a state, breaks something, and insists on what edgectl must say meanwhile. What follows
is the same for all: everything is mended, *one* apply runs, and the oracle must find every wanted task exactly once, none doubled at any
moment since the beginning, no stranger signalled; then all is stopped, and nothing may be left.
"""

import random
import subprocess
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.armed import reached
from tests.faults.computer import missing_for_namespaces
from tests.faults.fleet import Fleet, How, OracleError, fleet_of, heal
from tests.faults.oracle import Verdict
from tests.faults.outcome import ExpectationError

Inject = Callable[[Fleet], None]
EDGES = ("edge1", "edge2")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One row of the table. ``kinds``: the hosts on which it can be injected honestly; ``full``: how often;
    ``quick``: whether it belongs to the short form, too (once, on the best kind of host)."""

    name: str
    inject: Inject
    kinds: tuple[str, ...]
    quick: bool
    full: int
    hosts: tuple[str, ...]
    missing: Callable[[], str]


@dataclass(kw_only=True)
class Row:
    """What came of a fault on one kind of host."""

    fault: str
    kind: str
    injected: int = 0
    survived: int = 0
    lost: int = 0
    doubled: int = 0
    seconds: float = 0.0
    not_run: str = ""
    failures: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        return self.survived == self.injected and not self.lost and not self.doubled


FAULTS: list[Fault] = []
BOTH = ("loopback", "namespace")
OWN = ("namespace",)


def fault(
    name: str,
    *,
    kinds: tuple[str, ...] = BOTH,
    quick: bool = False,
    full: int = 1,
    hosts: tuple[str, ...] = EDGES,
    missing: Callable[[], str] = str,
) -> Callable[[Inject], Inject]:
    """Put a function on the list."""

    def add(inject: Inject) -> Inject:
        FAULTS.append(
            Fault(name=name, inject=inject, kinds=kinds, quick=quick, full=full, hosts=hosts, missing=missing)
        )
        return inject

    return add


def quick_cases() -> list[tuple[Fault, str]]:
    """The short form: once each, on a computer of its own where that can be had."""
    poor = bool(missing_for_namespaces())
    return [(each, each.kinds[0] if poor else each.kinds[-1]) for each in FAULTS if each.quick]


def aftermath(fleet: Fleet) -> None:
    """Mend everything, apply once, judge; stop all, and look for leftovers."""
    heal(fleet)
    fleet.apply().must(0)
    fleet.check()
    fleet.edgectl("stop", "--all", "--yes").must(0)
    if not (left := fleet.leftovers()).clean:
        raise OracleError(left)
    fleet.check({})


@dataclass(kw_only=True)
class Came:
    """What came of one fleet: how many injections it saw, and what went wrong in the last; an empty text is survival.
    ``points``: the last named points at which the manager was killed there."""

    injected: int = 1
    points: str = ""
    wrong: str | Verdict = ""


def inject_once(each: Fault, kind: str, seed: int, how: How | None = None) -> Came:
    """Inject the fault into a new fleet."""
    came = Came()
    with tempfile.TemporaryDirectory(prefix="edgectl-faults-") as directory:
        try:
            with fleet_of(kind, Path(directory), list(each.hosts), seed, how) as fleet:
                _inject(each, fleet, came)
        except OracleError as error:
            came.wrong = error.verdict
        except ExpectationError as error:
            came.wrong = str(error)
        except (AssertionError, OSError, ValueError, KeyError, subprocess.SubprocessError):
            came.wrong = f"the harness itself failed: {traceback.format_exc(limit=-3)}"
    return came


def _inject(each: Fault, fleet: Fleet, came: Came) -> None:
    try:
        each.inject(fleet)
        aftermath(fleet)
    finally:
        came.injected = max(1, fleet.injected)
        came.points = f" after {', '.join(reached(fleet.notes)[-3:])}" if fleet.injected else ""


def run(each: Fault, kind: str, times: int, seed: int, how: How | None = None) -> Row:
    """Inject the fault that often; every injection has a seed of its own, named where it fails."""
    row = Row(fault=each.name, kind=kind)
    row.not_run = (missing_for_namespaces() if kind == "namespace" else "") or each.missing()
    if row.not_run:
        return row
    begun, seeds = time.monotonic(), random.Random(f"{seed} {each.name} {kind}")
    for _ in range(times):
        one = seeds.randrange(10**9)
        came = inject_once(each, kind, one, how)
        row.injected += came.injected
        row.survived += came.injected - bool(came.wrong)
        if isinstance(came.wrong, Verdict):
            row.lost += len(came.wrong.lost)
            row.doubled += len(came.wrong.doubled)
        if came.wrong:
            row.failures.append(f"{each.name} ({kind}, seed {one}){came.points}: {came.wrong}")
    row.seconds = time.monotonic() - begun
    return row


def table(rows: Iterable[Row]) -> str:
    """The rows as a markdown table with its sum."""
    rows = list(rows)
    lines = ["| fault | hosts | injected | survived | lost | doubled | s |", "|---|---|--:|--:|--:|--:|--:|"]
    for row in rows:
        if row.not_run:
            lines.append(f"| {row.fault} | {row.kind} | not run: {row.not_run} | | | | |")
        else:
            lines.append(
                f"| {row.fault} | {row.kind} | {row.injected} | {row.survived} | {row.lost} | {row.doubled} | {row.seconds:.0f} |"
            )
    sums = [sum(getattr(row, name) for row in rows) for name in ("injected", "survived", "lost", "doubled")]
    lines.append(f"| **all** | | {' | '.join(map(str, sums))} | {sum(row.seconds for row in rows):.0f} |")
    if sums[0] == sums[1] > 0 == sums[2] + sums[3]:
        lines.append(
            f"\nNone lost, none doubled in {sums[0]} injections: with 95 % confidence fewer than {min(100, 300 / sums[0]):.1f} % are."
        )
    return "\n".join(lines)
