# SPDX-License-Identifier: Apache-2.0
"""Fault injection on real hosts: ``python -m tests.faults``."""

import argparse
import math
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.faults import fault_list, injection_record
from tests.faults.fleet import EdgectlVariant
from tests.faults.injection_record import Case
from tests.faults.registry import (
    Fault,
    FaultRow,
    InjectionResult,
    format_table,
    list_quick_cases,
    run_fault,
)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the short form that is part of make test")
    parser.add_argument("--seed", type=int, default=1, help="random seed")
    parser.add_argument(
        "--injection", type=int, metavar="SEED", help="repeat the one injection whose failure names this seed"
    )
    parser.add_argument(
        "--only",
        default="",
        metavar="TEXT",
        help="run faults whose name contains this text, or whose kind of host or module (noise, link) it is",
    )
    parser.add_argument(
        "--hosts",
        choices=["loopback", "namespace", "systemd", "containers"],
        help="run faults on this kind of host only",
    )
    parser.add_argument(
        "--times", type=int, default=0, help="injections per fault (default: set by each fault)"
    )
    parser.add_argument(
        "--points",
        type=int,
        default=None,
        help="kills of the manager per kind of command (default: at every point; -20: at the last twenty)",
    )
    parser.add_argument(
        "--jobs", type=int, default=2, help="faults injected in parallel, each on its own hosts"
    )
    parser.add_argument(
        "--connection", choices=["ssh", "openssh"], default="ssh", help="connection of edgectl to the hosts"
    )
    parser.add_argument(
        "--one-channel",
        action="store_true",
        default=None,
        help="hosts that allow one channel per connection, MaxSessions 1 (default: for one seed in five)",
    )
    parser.add_argument(
        "--swarm", action="store_true", help="containers are services of a Docker Swarm of the hosts"
    )
    parser.add_argument(
        "--record",
        type=Path,
        metavar="FILE",
        help="go on after the injections in this file, with those faults first that were injected least, and add to it",
    )
    parser.add_argument(
        "--minutes", type=float, default=math.inf, help="begin no injection later than this (default: all)"
    )
    parser.add_argument("--code", type=Path, help="directory of another edgectl package to test")
    options = parser.parse_args()
    rows = inject_all(options)
    print(format_table(rows))
    if options.record:
        recorded = injection_record.build_rows(read_recorded(options))
        print(f"\nAll of {options.record}:\n\n{format_table(recorded)}")
    return 0 if rows and all(row.good for row in rows) else 1


def inject_all(options: argparse.Namespace) -> list[FaultRow]:
    """Inject the faults once through; with a record and a limit of time again and again until that."""
    until, rows = time.monotonic() + 60 * options.minutes, list[FaultRow]()
    while True:
        cases = injection_record.order_cases(list_cases(options), read_recorded(options))
        with ThreadPoolExecutor(options.jobs) as pool:
            found = list(pool.map(lambda case: run_case(case, options, until), cases))
        # Of a later round, what had no time left says nothing.
        rows += found if not rows else [row for row in found if row.injected]
        goes_on = options.record and options.minutes < math.inf and any(row.injected for row in found)
        if not goes_on or time.monotonic() >= until:
            return rows


def read_recorded(options: argparse.Namespace) -> list[injection_record.RecordedInjection]:
    """Read what earlier runs have recorded."""
    return injection_record.read_records(options.record) if options.record else []


def list_cases(options: argparse.Namespace) -> list[Case]:
    """Return the faults to inject, with kind of host and number of injections."""
    every = (
        list_quick_cases()
        if options.quick
        else [(each, kind) for each in fault_list.list_faults() for kind in each.kinds]
    )
    wanted = [
        (each, kind)
        for each, kind in every
        if (options.only in each.name or options.only in (kind, get_module(each)))
        and kind == ("containers" if options.swarm else options.hosts or kind)
    ]
    return [
        (each, kind, options.times or (1 if options.quick else get_full(each, kind))) for each, kind in wanted
    ]


def get_module(each: Fault) -> str:
    """``noise`` of a fault in faults_noise.py."""
    return each.inject.__module__.rpartition("faults_")[2]


def get_full(each: Fault, kind: str) -> int:
    """Number of injections; over containers a quarter of those over commands, whose manager is the same."""
    return (each.full + 3) // 4 if kind == "containers" != each.kinds[0] else each.full


def run_case(case: Case, options: argparse.Namespace, until: float) -> FaultRow:
    """Inject a fault and report it at once."""

    def note(seed: int, result: InjectionResult, seconds: float) -> None:
        if options.record:
            injection_record.add_record(options.record, case, options.seed, seed, result, seconds=seconds)

    row = run_fault(
        *case,
        options.seed,
        EdgectlVariant(
            code=options.code,
            connection=options.connection,
            sample=options.quick,
            points=1 if options.quick else options.points,
            swarm=options.swarm,
            one_channel=options.one_channel,
        ),
        exactly=options.injection,
        skip=injection_record.count_seeds(read_recorded(options), case, options.seed),
        until=until,
        report=print_progress,
        note=note,
    )
    if row.not_run:
        print_progress(row)
    return row


def print_progress(row: FaultRow) -> None:
    """Print the progress of a fault, and its failures so far, to stderr."""
    word = f"not run: {row.not_run}" if row.not_run else f"{row.survived}/{row.injected}"
    print(
        f"{row.fault} ({row.kind}): {word} in {row.seconds:.0f} s",
        *row.failures,
        sep="\n  ",
        file=sys.stderr,
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
