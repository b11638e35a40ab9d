# SPDX-License-Identifier: Apache-2.0
"""Start-up time: ``python -m tests.benchmarks.startup``.

``edgectl --help`` against an empty typer app of as many commands (ratio of medians, runs interleaved), and
``plan --snapshot`` of 50 hosts x 200 tasks, start to end, which may not import fabric or paramiko.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from edgectl.cli.app import COMMANDS
from tests.benchmarks.ratios import note_ratio

RUNS = 15
HELP_GOAL = 1.15
PLAN_GOAL_S = 1.0
EDGES, ROBOTS, TASKS = 50, 10, 200
COMMAND = "import sys; from edgectl.cli.main import main; sys.exit(main())"
EMPTY = f"""
import typer
app = typer.Typer(add_completion=False, rich_markup_mode=None)
def nothing(): pass
for number in range({len(COMMANDS)}):
    app.command(f"command{{number}}", help="Do something that takes a line to describe.")(nothing)
app()
"""


def measure_run_s(command: Sequence[str], directory: Path) -> float:
    """Return the wall time of one run."""
    began = time.perf_counter()
    subprocess.run([sys.executable, *command], cwd=directory, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - began


def measure_interleaved(commands: Sequence[Sequence[str]], directory: Path) -> list[list[float]]:
    """Return the times of each command, run in turns, so that other load affects all alike."""
    rounds = [[measure_run_s(command, directory) for command in commands] for _ in range(RUNS + 1)][1:]
    return [list(column) for column in zip(*rounds, strict=True)]


def write_fleet(directory: Path) -> None:
    """An inventory, tasks and a snapshot of 50 edges, 10 robots and 200 tasks, half of them running."""
    edges, robots = [f"edge{n}" for n in range(1, EDGES + 1)], [f"robot{n}" for n in range(1, ROBOTS + 1)]
    lines = [
        "version: 1",
        "edges:",
        *(f"  {edge}: {{host: 10.0.0.{n}}}" for n, edge in enumerate(edges, 1)),
        "robots:",
    ]
    lines += [f"  {robot}: {{host: 10.0.1.{n}, probe: false}}" for n, robot in enumerate(robots, 1)]
    (directory / "inventories").mkdir()
    (directory / "inventories" / "lab.yaml").write_text("\n".join(lines) + "\n")
    tasks = ["version: 1", "tasks:"]
    for number in range(1, TASKS + 1):
        needs = f", needs: [task{number - 1}]" if number % 4 > 1 else ""
        robot = robots[number % ROBOTS]
        tasks.append(
            f"  task{number}: {{robot: {robot}, command: run {number}, demand: {{cpu: 0.4, memory: 200Mi, throughput: 200kB/s}}{needs}}}"
        )
    (directory / "tasks").mkdir()
    (directory / "tasks" / "lab.yaml").write_text("\n".join(tasks) + "\n")
    hosts = {edge: _sample(place, robots) for place, edge in enumerate(edges)}
    (directory / "snap.json").write_text(
        json.dumps({"format_version": 2, "taken_at": "2026-11-21T08:00:00Z", "hosts": hosts})
    )


def _sample(place: int, robots: list[str]) -> dict[str, object]:
    running = range(place * 2 + 1, place * 2 + 3)
    link = {
        "capacity_bytes_per_s": 6_750_000,
        "used_bytes_per_s": 1000 * place,
        "rtt_ms": 2.5,
        "capacity_source": "nic",
    }
    task = {
        "state": "running",
        "pid": 100,
        "started_at": "2026-11-21T07:00:00Z",
        "cpu": {"used_cores": 0.4},
        "memory": {"used_bytes": 2e8},
        "network": {"used_bytes_per_s": 2e5},
    }
    return {
        "role": "edge",
        "status": "ok",
        "cpu": {"capacity_cores": 4, "used_cores": 1 + place / 100},
        "memory": {"capacity_bytes": 4 * 2**30, "used_bytes": 2**30},
        "links": dict.fromkeys(robots, link),
        "tasks": {f"task{number}": task for number in running},
    }


def list_imports(directory: Path, *words: str) -> set[str]:
    """Return the top-level packages that a command imports."""
    command = [sys.executable, "-X", "importtime", "-c", COMMAND, *words]
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, check=True)
    return {
        line.rpartition("|")[2].strip().partition(".")[0]
        for line in done.stderr.splitlines()
        if line.startswith("import time:")
    }


def main() -> int:
    """Print the table; return 1 if a goal is missed."""
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        write_fleet(directory)
        empty, help_text, plan = measure_interleaved(
            [
                ["-c", EMPTY, "--help"],
                ["-c", COMMAND, "--help"],
                ["-c", COMMAND, "plan", "--snapshot", "snap.json"],
            ],
            directory,
        )
        heavy = list_imports(directory, "plan", "--snapshot", "snap.json") & {"fabric", "paramiko"}
    ratio = statistics.median(help_text) / statistics.median(empty)
    took = statistics.median(plan)
    print(f"{'what':<44}{'median ms':>10}{'min ms':>8}")
    for what, times in (
        ("empty typer app --help", empty),
        ("edgectl --help", help_text),
        (f"edgectl plan --snapshot, {EDGES} x {TASKS}", plan),
    ):
        print(f"{what:<44}{statistics.median(times) * 1000:>10.0f}{min(times) * 1000:>8.0f}")
    print(f"edgectl --help / empty app: {ratio:.2f} (goal {HELP_GOAL})")
    print(
        f"plan --snapshot: {took:.2f} s (goal {PLAN_GOAL_S:.1f} s); imports of ssh: {', '.join(sorted(heavy)) or 'none'}"
    )
    note_ratio("edgectl --help", ratio, of="an empty typer app", most=HELP_GOAL)
    note_ratio("plan --snapshot of 50 x 200", took / PLAN_GOAL_S, of=f"{PLAN_GOAL_S:g} s", most=1.0)
    return int(ratio > HELP_GOAL or took > PLAN_GOAL_S or bool(heavy))


if __name__ == "__main__":
    sys.exit(main())
