# SPDX-License-Identifier: Apache-2.0
"""Run every benchmark of this package, each in a process of its own: ``python -m tests.benchmarks``."""

import subprocess
import sys
from pathlib import Path

ORDER = ("startup", "planner", "probe_fanout")


def main() -> int:
    """Return the exit status: 0, or 1 if a benchmark failed or missed its goal."""
    here = Path(__file__).parent
    names = sorted(path.stem for path in here.glob("*.py") if not path.stem.startswith("_"))
    names.sort(key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER))
    failed = []
    for name in names:
        print(f"== {name}", flush=True)
        if (
            subprocess.run(
                [sys.executable, "-m", f"tests.benchmarks.{name}"], cwd=here.parents[1], check=False
            ).returncode
            != 0
        ):
            failed.append(name)
        print()
    if failed:
        print("missed or failed:", ", ".join(failed))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
