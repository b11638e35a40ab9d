# SPDX-License-Identifier: Apache-2.0
"""The tables of docs/concepts/quality.md, as they stand there: ``make quality``; some five minutes.

``python -m tests.quality Moves Stability`` prints these alone.
"""

import sys
from collections.abc import Collection

from tests.quality.measures import measure_yardstick
from tests.quality.tables import build_tables


def print_tables(headings: Collection[str]) -> None:
    """Print each row as soon as it is known; before each table, how fast the machine is."""
    for table in build_tables():
        if headings and table.heading not in headings:
            continue
        print(f"## {table.heading}\n\nYardstick: {measure_yardstick():.2f} s.\n", flush=True)
        for line in table.list_lines():
            print(line, flush=True)
        print()


if __name__ == "__main__":
    print_tables(sys.argv[1:])
