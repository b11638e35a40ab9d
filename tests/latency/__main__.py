# SPDX-License-Identifier: Apache-2.0
"""Print the tables of docs/concepts/predicted-latency.md: ``python -m tests.latency [--jobs 600] [--seeds 5]``.

Needs root, and a machine that does nothing else: the column FOREIGN says what it did. ``--keep FILE`` writes every job,
``--again FILE`` predicts what such a file measured, without measuring anything.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

from tests.latency.bench import make_benches, preferred_processes
from tests.latency.tables import (
    Row,
    compare_presets,
    format_record,
    measure_rows,
    print_comparisons,
    print_rows,
    read_rows,
)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--jobs", type=int, default=600, help="jobs of each placement")
    parser.add_argument("--seeds", type=int, default=5, help="fleets of each kind of links")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="write the jobs of all placements")
    parser.add_argument("--again", type=Path, metavar="FILE", help="predict the jobs of a file again")
    options = parser.parse_args()
    if options.again:
        print_table(read_rows(options.again), None)
        return
    with preferred_processes() as preferred, make_benches(1) as [bench]:
        if not preferred:
            print("these processes do not go before others: no control groups v1 for CPU shares here")
        print_table(measure_rows(bench, jobs=options.jobs), options.keep)
        print("| Mbit/s | load | preset all | preset latency |\n|---|---|---:|---:|")
        found = []
        for each in compare_presets(bench, jobs=max(20, options.jobs // 2), seeds=range(options.seeds)):
            found.append(each)
            print(each.format(), flush=True)
        print_comparisons(found)


def print_table(rows: Iterable[Row], keep: Path | None) -> None:
    """Print each row once it is there, and the errors of all."""
    print("| frame | Mbit/s | load | foreign | p50 predicted / measured ms | p99 | in the interval |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    done = []
    for row in rows:
        done.append(row)
        print(row.format(), flush=True)
        if keep is not None:
            with keep.open("a") as file:
                file.write(format_record(row) + "\n")
    print_rows(done)


if __name__ == "__main__":
    main()
