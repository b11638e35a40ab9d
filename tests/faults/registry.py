# SPDX-License-Identifier: Apache-2.0
"""Registry of faults, injection of one fault, and the result table.

A fault is one function: it prepares the fleet, breaks something, and checks what edgectl reports meanwhile.
The rest is the same for all: three hosts or more; everything is repaired, *one* apply runs, and the oracle must find
every expected task exactly once, none doubled at any moment since the beginning, and no bystander signalled; then
all tasks are stopped, at random by a manager that was never there before, and nothing may be left.
"""

import math
import random
import subprocess
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from tests.compiled_agent import give_key
from tests.containers.docker_engine import find_missing_for_containers
from tests.faults.command_result import ExpectationError
from tests.faults.failpoint_runner import read_failpoints
from tests.faults.fleet import FLEET, EdgectlVariant, FaultFleet, OracleError, open_fleet, repair_fleet
from tests.faults.namespace_host import find_missing_for_namespaces, find_missing_for_systemd
from tests.faults.oracle import OracleVerdict

Inject = Callable[[FaultFleet], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A registered fault. ``kinds``: kinds of hosts that support it; ``full``: number of injections;
    ``quick``: whether it belongs to the short form (once, on the first of the kinds).
    """

    name: str
    inject: Inject
    kinds: tuple[str, ...]
    quick: bool
    full: int
    missing: Callable[[], str]


@dataclass(kw_only=True)
class FaultRow:
    """Result of a fault on one kind of host."""

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
# Also on computers whose PID 1 is systemd; not in the short form.
ALL = (*BOTH, "systemd")
# Computers in namespaces, each with a Docker Engine: every task runs in a container.
CONTAINERS = ("containers",)


def find_missing_for_engines() -> str:
    """Return why no computer can have an engine here; empty if they can."""
    return find_missing_for_namespaces() or find_missing_for_containers()


MISSING = {
    "namespace": find_missing_for_namespaces,
    "systemd": find_missing_for_systemd,
    "containers": find_missing_for_engines,
}


def fault(
    name: str,
    *,
    kinds: tuple[str, ...] = BOTH,
    quick: bool = False,
    full: int = 1,
    missing: Callable[[], str] = str,
) -> Callable[[Inject], Inject]:
    """Register a function as a fault. What computers in namespaces support is injected over containers, too."""
    every = (*kinds, *CONTAINERS) if "namespace" in kinds else kinds

    def add(inject: Inject) -> Inject:
        FAULTS.append(Fault(name=name, inject=inject, kinds=every, quick=quick, full=full, missing=missing))
        return inject

    return add


def list_quick_cases() -> list[tuple[Fault, str]]:
    """Return the short form: each quick fault once, on the cheapest kind of host that supports it."""
    return [(each, each.kinds[0]) for each in FAULTS if each.quick]


def repair_and_judge(fleet: FaultFleet) -> None:
    """Repair everything, apply once, judge; stop all, at random as a newcomer, and check for leftovers."""
    repair_fleet(fleet)
    fleet.apply().expect_exit(0)
    fleet.check_verdict()
    give_key(fleet.directory / "state-newcomer", FLEET)
    newcomer = {"EDGECTL_STATE_DIR": str(fleet.directory / "state-newcomer"), "LOGNAME": "newcomer"}
    fleet.run_edgectl("stop", "--all", "--yes", **fleet.random.choice([newcomer, {}])).expect_exit(0)
    if not (left := fleet.find_leftovers()).clean:
        raise OracleError(left)
    fleet.check_verdict({})


@dataclass(kw_only=True)
class InjectionResult:
    """Result of one fleet: number of injections, and the failure of the last (empty: survived). ``points``:
    the last failpoints at which the manager was killed.
    """

    injected: int = 1
    points: str = ""
    wrong: str | OracleVerdict = ""


def inject_once(each: Fault, kind: str, seed: int, variant: EdgectlVariant | None = None) -> InjectionResult:
    """Inject the fault into a new fleet."""
    result = InjectionResult()
    with tempfile.TemporaryDirectory(prefix="edgectl-faults-") as directory:
        try:
            with open_fleet(kind, Path(directory), draw_names(seed, variant), seed, variant) as fleet:
                _inject_fault(each, fleet, result)
        except OracleError as error:
            result.wrong = error.verdict
        except ExpectationError as error:
            result.wrong = str(error)
        except (AssertionError, OSError, ValueError, KeyError, subprocess.SubprocessError):
            result.wrong = f"the harness itself failed: {traceback.format_exc(limit=-3)}"
    return result


def _inject_fault(each: Fault, fleet: FaultFleet, result: InjectionResult) -> None:
    try:
        each.inject(fleet)
        repair_and_judge(fleet)
    finally:
        result.injected = max(1, fleet.injected)
        points = ", ".join(read_failpoints(fleet.failpoint_log)[-3:])
        result.points = f" after {points}" if points else f" in round {fleet.injected}" * bool(fleet.injected)


def draw_names(seed: int, variant: EdgectlVariant | None = None) -> list[str]:
    """Draw the names of the hosts in a random order: three, or five for one seed in six of the whole matrix."""
    drawn = random.Random(f"names {seed}")
    more = drawn.random() < 1 / 6 and not (variant and variant.sample)
    names = [f"edge{number}" for number in range(1, 6 if more else 4)]
    drawn.shuffle(names)
    return names


def draw_seeds(each: Fault, kind: str, times: int, seed: int) -> list[int]:
    """Draw the seeds of ``times`` injections."""
    seeds = random.Random(f"{seed} {each.name} {kind}")
    return [seeds.randrange(10**9) for _ in range(times)]


def run_fault(
    each: Fault,
    kind: str,
    times: int,
    seed: int,
    variant: EdgectlVariant | None = None,
    *,
    exactly: int | None = None,
    skip: int = 0,
    until: float = math.inf,
    report: Callable[[FaultRow], None] = lambda _row: None,
    note: Callable[[int, InjectionResult, float], None] = lambda _seed, _result, _seconds: None,
) -> FaultRow:
    """Inject the fault ``times`` times; every injection has its own seed, printed with a failure.

    ``exactly``: the seed of the one injection to repeat; ``skip``: so many of the first seeds were used before.
    None begins after ``until``, of the monotonic clock. ``report`` gets the row after each injection, ``note``
    its seed, result and seconds.
    """
    row = FaultRow(fault=each.name, kind=kind)
    row.not_run = MISSING.get(kind, str)() or each.missing()
    if row.not_run:
        return row
    begun = time.monotonic()
    for one in draw_seeds(each, kind, skip + times, seed)[skip:] if exactly is None else [exactly]:
        if (now := time.monotonic()) >= until:
            break
        result = inject_once(each, kind, one, variant)
        note(one, result, time.monotonic() - now)
        row.injected += result.injected
        row.survived += result.injected - bool(result.wrong)
        if isinstance(result.wrong, OracleVerdict):
            row.lost += len(result.wrong.lost)
            row.doubled += len(result.wrong.doubled)
        if result.wrong:
            row.failures.append(f"{each.name} ({kind}, seed {one}){result.points}: {result.wrong}")
        row.seconds = time.monotonic() - begun
        report(row)
    row.not_run = "" if row.injected else "no time left"
    return row


def format_table(rows: Iterable[FaultRow]) -> str:
    """Format the rows as a Markdown table with totals."""
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
    if left := [row for row in rows if row.not_run]:
        whys = ", ".join(sorted({row.not_run for row in left}))
        lines.append(f"\nNOT RUN: {len(left)} of {len(rows)} faults ({whys}).")
    if sums[0] == sums[1] > 0 == sums[2] + sums[3]:
        lines.append(
            f"\nNone lost, none doubled in {sums[0]} injections: with 95 % confidence fewer than {min(100, 300 / sums[0]):.1f} % are."
        )
    return "\n".join(lines)
