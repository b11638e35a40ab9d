# SPDX-License-Identifier: Apache-2.0
"""Commands over slow and lossy lines beside ``ssh`` (`tests.slow_links`), once each: ``python -m tests.benchmarks.slow_lines``.

Root is needed: the lines are cables between network namespaces.
"""

import sys

from tests.faults.namespace_host import find_missing_for_namespaces
from tests.slow_links.__main__ import main as measure_lines


def main() -> int:
    """Print the tables; return 1 where a goal is missed, and where it cannot run."""
    if why := find_missing_for_namespaces():
        print(f"not run: {why}")
        return 1
    return measure_lines(["1"])


if __name__ == "__main__":
    sys.exit(main())
