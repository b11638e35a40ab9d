# SPDX-License-Identifier: Apache-2.0
"""Applies over warm connections against the programs' own start: ``python -m tests.benchmarks.apply [RUNS]``.

Ten tasks on three real SSH servers of this machine, to which the probe of the plan has logged in. Measured from the
moment when the plan is there to the last ``ready``; in turns with the same programs, each started by a shell of its
own, all at once, until the last one has done what its check waits for. ``tests/e2e/test_apply_requests.py`` counts the requests.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from edgectl.model.check import Check
from edgectl.model.progress import ProgressEvent, ProgressStage
from edgectl.model.result import Phase
from edgectl.model.task import Task
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from tests.benchmarks.ratios import note_ratio
from tests.builders import a_task, an_inventory
from tests.e2e.bench import EAGER, GENTLE, QUICK, Bench, a_slice, open_bench
from tests.leftovers import end_started_in
from tests.sshd import Lab, running_lab

GOAL = 1.3
HOSTS = ("edge3", "edge2", "edge1")
COUNT, READY_S = 10, 60.0
# What each program does until it is ready.
PROGRAMS: Mapping[str, str] = {
    "waits for 1 s": "sleep 1",
    "imports for 1 s": "sleep 0.9; python3 -c 'import asyncio, ssl, email, http.client, xml.dom.minidom'",
}


def build_tasks(work: str, folder: Path) -> list[Task]:
    """Ten tasks, pinned to the hosts in turns; each makes a file once it is ready."""
    return [
        a_task(
            f"task{number:02}",
            command=f"{work}; touch {folder}/task{number:02}; exec sleep 600",
            ready=Check(command=f"test -e {folder}/task{number:02}", timeout=READY_S),
            pin=HOSTS[number % len(HOSTS)],
            stop=GENTLE,
        )
        for number in range(COUNT, 0, -1)
    ]


def measure_own_start_s(tasks: Sequence[Task], folder: Path) -> float:
    """Seconds until all programs are ready that a shell each starts at once."""
    began = time.perf_counter()
    running = [
        subprocess.Popen(["/bin/bash", "-c", task.command], cwd=folder, stdin=subprocess.DEVNULL)
        for task in tasks
    ]
    while not all((folder / task.name).exists() for task in tasks):
        time.sleep(0.002)
    took = time.perf_counter() - began
    for process in running:
        process.kill()
        process.wait()
    return took


def measure_apply_s(bench: Bench) -> float:
    """Seconds from the plan to the last task that is ready; all are started."""
    moments: list[float] = []

    def confirm(_plan: object) -> bool:
        moments.append(time.perf_counter())
        return True

    def note(event: ProgressEvent) -> None:
        if event.stage is ProgressStage.PHASE_END and event.phase is Phase.READY:
            moments.append(time.perf_counter())

    options = ApplyOptions(probe=QUICK, progress=note)
    applied = plan_and_apply(bench.fleet, EAGER, confirm, options)
    assert applied.results is not None
    assert applied.results.done, applied.results
    assert len(moments) == COUNT + 1
    return moments[-1] - moments[0]


def measure_program(lab: Lab, work: str, folder: Path, runs: int) -> tuple[list[float], list[float]]:
    """Seconds of the programs alone, and of edgectl, in turns."""
    folder.mkdir()
    tasks = build_tasks(work, folder)
    inventory = an_inventory(*(a_slice(lab.host(name)) for name in HOSTS))
    alone, ours = list[float](), list[float]()
    with open_bench(inventory, folder / "manager", lab) as manager:
        bench = manager.using(*tasks)
        for turn in range(-1, runs):
            took = [0.0, 0.0]
            for which in (0, 1):
                for task in tasks:
                    (folder / task.name).unlink(missing_ok=True)
                took[which] = measure_apply_s(bench) if which else measure_own_start_s(tasks, folder)
            bench.stop()
            end_started_in([folder])
            if turn >= 0:
                alone.append(took[0])
                ours.append(took[1])
    return alone, ours


def main(words: Sequence[str]) -> int:
    """Print the table; return 1 if the goal is missed."""
    runs, worst = int(words[0]) if words else 9, 0.0
    print(f"{COUNT} tasks on {len(HOSTS)} hosts, from the plan to the last ready, s: medians of {runs}")
    print(f"{'a program that':<20}{'its own start':>15}{'edgectl':>10}{'ratio':>8}")
    with tempfile.TemporaryDirectory(prefix="edgectl-") as directory:
        folder = Path(directory)
        with running_lab(folder / "lab", HOSTS) as lab:
            os.environ.update(lab.environment, EDGECTL_STATE_DIR=str(folder / "state"))
            for number, (name, work) in enumerate(PROGRAMS.items()):
                alone, ours = measure_program(lab, work, folder / f"program{number}", runs)
                ratio = statistics.median(mine / own for mine, own in zip(ours, alone, strict=True))
                worst = max(worst, ratio)
                note_ratio(f"apply of ten programs; each {name}", ratio, of="their own start", most=GOAL)
                print(
                    f"{name:<20}{statistics.median(alone):>15.2f}{statistics.median(ours):>10.2f}{ratio:>8.2f}",
                    flush=True,
                )
    print(f"goal: {GOAL}; reached: {worst:.2f}")
    return int(worst > GOAL)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
