# SPDX-License-Identifier: Apache-2.0
"""``make model``: every state of the model in several bounds, then traces of real faults against it.

Prints the tables of docs/model/README.md.
"""

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

from tests.protocol.observed import check_observation, list_observable_faults, observe_fault
from tests.protocol.tlc import Bounds, check_model, format_config

CASES = (
    Bounds(hosts=3, tasks=2, runs=2),
    Bounds(hosts=3, tasks=1, runs=2),
    Bounds(hosts=2, tasks=2, runs=2),
    Bounds(),
    Bounds(hosts=3, tasks=2, uses_etcd=True),
    Bounds(hosts=3, tasks=2, runs=2, uses_etcd=True),
    Bounds(hosts=3, tasks=1, uses_etcd=True),
)


def main() -> int:
    """Check, print, and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--traces", type=int, default=2, help="injections of each fault")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only-traces", action="store_true", help="without the states of the model")
    parser.add_argument(
        "--hosts",
        choices=["loopback", "containers"],
        default="loopback",
        help="where the faults are injected",
    )
    parser.add_argument("--memory", default="6g", help="heap of Java")
    options = parser.parse_args()
    wrong = 0 if options.only_traces else check_bounds(options.memory)
    return wrong or check_faults(options.hosts, options.traces, options.seed, options.memory)


def check_bounds(memory: str) -> int:
    """Every state of each of the cases."""
    print("| lease | managers | hosts | tasks | runs | reboots | states | s | result |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|---|")
    wrong = 0
    for bounds in CASES:
        began = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="edgectl-model-") as directory:
            verdict = check_model(
                Path(directory), format_config(bounds), whole=True, memory=memory, timeout_s=7200.0
            )
        wrong += bool(verdict.violated)
        counts = (bounds.managers, bounds.hosts, bounds.tasks, bounds.runs, bounds.reboots)
        cells = ["etcd" if bounds.uses_etcd else "hosts", *map(str, counts), f"{verdict.states:,}"]
        cells += [f"{time.monotonic() - began:.0f}", verdict.violated or "holds"]
        print(f"| {' | '.join(cells)} |", flush=True)
    return int(wrong > 0)


def check_faults(kind: str, times: int, seed: int, memory: str) -> int:
    """Traces of the faults of two managers on real hosts."""
    print("| fault | traces | grants | starts | stops | accepted |\n|---|--:|--:|--:|--:|--:|")
    wrong = 0
    for each in list_observable_faults(kind):
        seeds = random.Random(f"{seed} {each.name}")
        counts = {"grant": 0, "start": 0, "stop": 0}
        accepted = 0
        for _ in range(times):
            seen = observe_fault(each, seeds.randrange(10**9), sample=True, kind=kind)
            for kind in counts:
                counts[kind] += seen.count(kind)
            with tempfile.TemporaryDirectory(prefix="edgectl-model-") as directory:
                fits, verdict = check_observation(seen, Path(directory), memory=memory)
            accepted += fits and not seen.gaps
            if not fits or seen.gaps:
                print(
                    f"{each.name}, seed {seen.seed}: {seen.gaps or 'not a behaviour of the model'}",
                    file=sys.stderr,
                )
                print(verdict.text[-2000:], file=sys.stderr)
        wrong += times - accepted
        print(f"| {each.name} | {times} | {' | '.join(map(str, counts.values()))} | {accepted} |", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
