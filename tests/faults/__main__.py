"""``python -m tests.faults``: break real hosts in every way on the list, and print what came of it."""

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.faults import matrix
from tests.faults.fleet import How
from tests.faults.registry import Fault, Row, quick_cases, run, table


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the short form that is part of make test")
    parser.add_argument("--seed", type=int, default=1, help="of everything that is drawn at random")
    parser.add_argument("--only", default="", metavar="TEXT", help="faults whose name holds this text")
    parser.add_argument("--hosts", choices=["loopback", "namespace"], help="this kind of host only")
    parser.add_argument(
        "--times", type=int, default=0, help="injections of each fault, instead of its own number"
    )
    parser.add_argument(
        "--jobs", type=int, default=2, help="faults that run at the same time, each on hosts of its own"
    )
    parser.add_argument(
        "--connection", choices=["ssh", "openssh"], default="ssh", help="how edgectl reaches the hosts"
    )
    parser.add_argument("--code", type=Path, help="directory of another edgectl package to judge")
    options = parser.parse_args()
    with ThreadPoolExecutor(options.jobs) as pool:
        rows = list(pool.map(lambda case: one_row(*case, options), cases(options)))
    print(table(rows))
    return 0 if rows and all(row.good for row in rows) else 1


def cases(options: argparse.Namespace) -> list[tuple[Fault, str, int]]:
    """The faults to inject, on which kind of host, and how often."""
    every = (
        quick_cases() if options.quick else [(each, kind) for each in matrix.faults() for kind in each.kinds]
    )
    wanted = [
        (each, kind) for each, kind in every if options.only in each.name and kind == (options.hosts or kind)
    ]
    return [(each, kind, options.times or (1 if options.quick else each.full)) for each, kind in wanted]


def one_row(each: Fault, kind: str, times: int, options: argparse.Namespace) -> Row:
    """Inject, and tell at once."""
    row = run(
        each,
        kind,
        times,
        options.seed,
        How(code=options.code, connection=options.connection, sample=options.quick),
    )
    tell(row)
    return row


def tell(row: Row) -> None:
    """Progress and failures on stderr, as they come."""
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
