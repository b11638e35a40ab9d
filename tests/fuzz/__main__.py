# SPDX-License-Identifier: Apache-2.0
"""Fuzz every decoder: ``python -m tests.fuzz --cases 15000 --seed 1 --seconds 900``."""

import argparse
import tempfile
import time
from pathlib import Path

from tests.fuzz.run import count_cases, run_target
from tests.fuzz.targets import build_targets


def main() -> int:
    """Return the exit status: 0, or 1 if a case failed or time ran out."""
    parser = argparse.ArgumentParser(prog="make fuzz")
    parser.add_argument("--cases", type=int, default=15_000, help="per decoder")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1800.0, help="in all")
    chosen = parser.parse_args()
    until, bad, total, short = time.monotonic() + chosen.seconds, [], 0, False
    print(f"{'DECODER':16}{'CASES':>8}{'READ':>8}{'REFUSED':>9}{'WRONG':>7}{'SLOWEST':>10}")
    with (
        tempfile.TemporaryDirectory(prefix="edgectl-fuzz-") as directory,
        build_targets(Path(directory)) as found,
    ):
        for target in found:
            tally = run_target(target, seed=chosen.seed, cases=chosen.cases, until=until)
            figures = f"{tally.cases:8,}{tally.accepted:8,}{tally.refused:9,}{len(tally.bad):7,}{tally.slowest_s * 1000:8.0f}ms"
            print(f"{target.name:16}{figures}", flush=True)
            bad += tally.bad
            total += tally.cases
            short = short or tally.cases < count_cases(target, chosen.cases)
    print(
        f"{total:,} cases, seed {chosen.seed}: {len(bad)} wrong"
        + ("; out of time before all cases" if short else "")
    )
    print("\n".join(bad[:20]))
    return 1 if bad or short else 0


if __name__ == "__main__":
    raise SystemExit(main())
