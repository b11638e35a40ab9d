# SPDX-License-Identifier: Apache-2.0
"""Run every benchmark of this package, each in a process of its own: ``python -m tests.benchmarks [NAME ..]``.

At the end all ratios that they have noted stand in one table. Before and after the benchmarks it says how fast the machine is: goals
that are times were set for an idle one (docs/performance.md).
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.benchmarks import ratios

# Of the machine that docs/performance.md describes, idle; up to twice as much while others use it.
_IDLE_MS = "103 to 115"
_IMPORT = "import time; began = time.process_time(); import paramiko; print(time.process_time() - began)"
ORDER = ("startup", "planner", "probe_fanout")
# These want a second version of the sources, which only a developer who compares two has.
OF_TWO_VERSIONS = ("watched_pair",)


def list_benchmarks() -> list[str]:
    """Return the names of all benchmarks that run without arguments."""
    here = Path(__file__).parent
    names = sorted(path.stem for path in here.glob("*.py") if '__name__ == "__main__"' in path.read_text())
    names = [name for name in names if not name.startswith("_") and name not in OF_TWO_VERSIONS]
    return sorted(names, key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER))


def main(words: Sequence[str]) -> int:
    """Return the exit status: 0, or 1 if a benchmark failed or missed its goal."""
    failed = []
    print_speed()
    with tempfile.TemporaryDirectory(prefix="edgectl-") as folder:
        noted = Path(folder) / "ratios"
        noted.touch()
        for name in words or list_benchmarks():
            print(f"== {name}", flush=True)
            if run_benchmark(name, noted) != 0:
                failed.append(name)
            print()
        found = ratios.read_ratios(noted)
    print_speed()
    print(ratios.format_table(found))
    if failed:
        print("missed or failed:", ", ".join(failed))
    return 1 if failed or not all(each.met for each in found) else 0


def print_speed() -> None:
    """Print how fast this machine is now, by what needs its caches as edgectl does: five times, the first of which may read from
    the disk.
    """
    command = [sys.executable, "-c", _IMPORT]
    found = [float(subprocess.check_output(command, text=True)) for _ in range(5)]
    times = ", ".join(f"{1000 * seconds:.0f}" for seconds in found)
    print(
        f"import paramiko: {times} ms of CPU (idle: {_IDLE_MS}); load average {os.getloadavg()[0]:.1f}\n",
        flush=True,
    )


def run_benchmark(name: str, noted: Path) -> int:
    """Return the exit status of one benchmark, which adds its ratios to the file ``noted``."""
    command = [sys.executable, "-m", f"tests.benchmarks.{name}"]
    where = Path(__file__).parents[2]
    environment = os.environ | {ratios.VARIABLE: str(noted)}
    return subprocess.run(command, cwd=where, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
