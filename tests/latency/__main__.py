# SPDX-License-Identifier: Apache-2.0
"""Print the tables of docs/concepts/predicted-latency.md: ``python -m tests.latency [--jobs 600] [--seeds 5]``.

Needs root, and a machine that does nothing else: the column FOREIGN says what it did.
"""

import argparse

from tests.latency.bench import make_benches, preferred_processes
from tests.latency.tables import compare_presets, measure_rows, print_comparisons, print_rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--jobs", type=int, default=600, help="jobs of each placement")
    parser.add_argument("--seeds", type=int, default=5, help="fleets of each kind of links")
    options = parser.parse_args()
    with preferred_processes() as preferred, make_benches(1) as [bench]:
        if not preferred:
            print("these processes do not go before others: no control groups v1 for CPU shares here")
        print("| frame | Mbit/s | load | foreign | p50 predicted / measured ms | p99 | in the interval |")
        print("|---|---:|---:|---:|---:|---:|---:|")
        rows = []
        for row in measure_rows(bench, jobs=options.jobs):
            rows.append(row)
            print(row.format(), flush=True)
        print_rows(rows)
        print("| Mbit/s | load | preset all | preset latency |\n|---|---|---:|---:|")
        found = []
        for each in compare_presets(bench, jobs=max(20, options.jobs // 2), seeds=range(options.seeds)):
            found.append(each)
            print(each.format(), flush=True)
        print_comparisons(found)


if __name__ == "__main__":
    main()
