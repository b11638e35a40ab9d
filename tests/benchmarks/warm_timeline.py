# SPDX-License-Identifier: Apache-2.0
"""Time of a cycle over open connections by milestone: ``python -m tests.benchmarks.warm_timeline [N ..]``.

``edgectl watch --every 1s`` of N real SSH servers of this machine, once the agents stay: wall time and CPU of the manager
between the milestones of a cycle, medians of several. With ``--apply`` each host is asked in each cycle by its agent, over
a window of 0.5 s, which is most of its time; without, hosts send what changed.
"""

import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.sshd import Lab, running_lab

SIZES = (3, 64)
# Cycles until all agents stay and send, and those that are measured.
FIRST, MEASURED = 12, 15
MILESTONES = {
    "asked": "files, lease; until the first request",
    "heard": "requests and replies",
    "sampled": "replies decoded, links, snapshot, state, history",
    "planned": "smoothing and plan",
    "ended": "events, output",
    "next": "until the next cycle: what came, pulses",
}
WAYS: Mapping[str, Sequence[str]] = {
    "asked by agents that stay": ("--apply",),
    "hosts send what changed": (),
}
# Notes wall and CPU time at the milestones of each cycle. What asks is found once it has been imported by edgectl.
PROGRAM = """
import json, os, sys, time
from edgectl.gateway import fanout
from edgectl.usecases import watch
cycles, ask = [], fanout.call_agent
def note(name):
    cycles[-1][name] = time.monotonic(), time.process_time()
def call(*args, **options):
    cycles[-1].setdefault("asked", (time.monotonic(), time.process_time()))
    try:
        return ask(*args, **options)
    finally:
        note("heard")
fanout.call_agent = call
loop = watch._WatchLoop
def wrap(name, before, after):
    within = getattr(loop, name)
    def run(*args, **options):
        if before:
            cycles.append({})
            note(before)
        try:
            return within(*args, **options)
        finally:
            note(after)
    setattr(loop, name, run)
wrap("_cycle", "began", "ended")
wrap("_sample", "", "sampled")
wrap("_plan", "", "planned")
from edgectl.cli.main import main
code = main()
with open(os.environ["TIMELINE_REPORT"], "w") as report:
    json.dump({"code": code, "cycles": cycles}, report)
"""
Cycle = dict[str, tuple[float, float]]


def write_files(folder: Path, names: Sequence[str]) -> None:
    """Write an inventory of slices of this machine, without links, and no tasks."""
    for name in ("inventories", "tasks"):
        (folder / name).mkdir(exist_ok=True)
    edges = "".join(f"  {name}: {{host: {name}, capacity: {{cpu: 2, memory: 1Gi}}}}\n" for name in names)
    (folder / "inventories" / "lab.yaml").write_text(f"version: 1\nfleet: warm\nedges:\n{edges}")
    (folder / "tasks" / "lab.yaml").write_text("version: 1\ntasks: {}\n")


def run_watch(lab: Lab, folder: Path, words: Sequence[str]) -> list[Cycle]:
    """Return wall and CPU s at the milestones of each cycle that is measured, since its begin."""
    environment = os.environ | lab.environment | {"EDGECTL_STATE_DIR": str(folder / "state")}
    environment |= {"TIMELINE_REPORT": str(folder / "timeline.json")}
    command = [sys.executable, "-c", PROGRAM, "watch", "--every", "1s"]
    command += ["--cycles", str(FIRST + MEASURED + 1), *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout[-2000:], done.stderr[-2000:])
    report: dict[str, Any] = json.loads((folder / "timeline.json").read_text())
    assert report["code"] == 0, (done.stdout[-2000:], done.stderr[-2000:])
    cycles: list[Cycle] = report["cycles"]
    for cycle, after in itertools.pairwise(cycles):
        cycle["next"] = after["began"]
    return cycles[FIRST:-1]


def print_timeline(cycles: Sequence[Cycle], size: int, way: str) -> None:
    """Print what passes until each milestone since the one before; what a cycle lacks takes no time."""
    asked = sum("asked" in cycle for cycle in cycles)
    print(f"{size} hosts, {way}; {asked} of {len(cycles)} cycles asked a host")
    print(f"  {'':<50}{'ms':>8}{'CPU, ms':>9}")
    for name, words in MILESTONES.items():
        spent = [take_step(cycle, name) for cycle in cycles]
        wall, cpu = (1000 * statistics.median(each[which] for each in spent) for which in (0, 1))
        print(f"  {words:<50}{wall:>8.1f}{cpu:>9.1f}")
    whole = [cycle["next"][1] - cycle["began"][1] for cycle in cycles]
    busy = [cycle["ended"][0] - cycle["began"][0] for cycle in cycles]
    print(
        f"  {'the whole cycle':<50}{1000 * statistics.median(busy):>8.1f}{1000 * statistics.median(whole):>9.1f}"
    )


def take_step(cycle: Cycle, name: str) -> tuple[float, float]:
    """Return wall and CPU s until a milestone since the one before it in this cycle."""
    if name not in cycle:
        return 0.0, 0.0
    before = max(
        (each for key, each in cycle.items() if key != name and each[0] <= cycle[name][0]),
        default=cycle[name],
    )
    return cycle[name][0] - before[0], cycle[name][1] - before[1]


def main(words: Sequence[str]) -> int:
    """Print the tables."""
    sizes = [int(word) for word in words] or list(SIZES)
    with tempfile.TemporaryDirectory(prefix="edgectl-") as directory:
        folder = Path(directory)
        with running_lab(folder / "lab", [f"edge{n}" for n in range(max(sizes), 0, -1)]) as lab:
            for size in sizes:
                write_files(folder, list(lab.servers)[:size])
                for way, options in WAYS.items():
                    print_timeline(run_watch(lab, folder, options), size, way)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
