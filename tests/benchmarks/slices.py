# SPDX-License-Identifier: Apache-2.0
"""Probe to plan of a fleet of slices of this machine: ``python -m tests.benchmarks.slices [--apply] [N ..]``.

``edgectl plan`` from its start to its last byte, of N slices and as many tasks. Each slice is a host of its own
for edgectl, with its own login and its own request; all logins are on one OpenSSH server on loopback, so the
machine does the work of manager and of all hosts. With ``--apply`` the tasks are started and stopped, too.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from edgectl.formats.kinds import SNAPSHOT_KIND
from tests.quality.measures import measure_yardstick
from tests.sshd import Lab, running_lab

SIZES = (1000,)
COMMAND = "import sys; from edgectl.cli.main import main; sys.exit(main())"


def write_fleet(directory: Path, size: int) -> None:
    """Slices of half a core and 256 MiB, and tasks of a quarter of a core."""
    lines = ["version: 1", "edges:"]
    lines += [
        f"  edge{number}: {{host: machine, capacity: {{cpu: 0.5, memory: 256Mi}}}}"
        for number in range(1, size + 1)
    ]
    (directory / "fleet.yaml").write_text("\n".join(lines) + "\n")
    tasks = ["version: 1", "tasks:"]
    tasks += [
        f"  task{number}: {{command: sleep 1d, demand: {{cpu: 0.25, memory: 64Mi}}}}"
        for number in range(1, size + 1)
    ]
    (directory / "tasks.yaml").write_text("\n".join(tasks) + "\n")


def run_edgectl(directory: Path, *words: str) -> tuple[bytes, float, float]:
    """The output of a command, its seconds, and its CPU seconds on the side of the manager."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-c", COMMAND, *words, "-i", "fleet.yaml", "-t", "tasks.yaml"]
    done = subprocess.run(command, cwd=directory, stdout=subprocess.PIPE, check=True)
    seconds = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure_fleet(lab: Lab, directory: Path, size: int) -> None:
    """Print one row: the whole command, and the part of it that needs no host."""
    directory.mkdir()
    os.environ |= {**lab.environment, "EDGECTL_STATE_DIR": str(directory / "state")}
    write_fleet(directory, size)
    output, whole, cpu = run_edgectl(directory, "plan", "-o", "json")
    plan = json.loads(output)
    hosts = plan["snapshot"]["hosts"].values()
    assert [host["status"] for host in hosts] == ["ok"] * size
    assert all(decision["host"] for decision in plan["decisions"])
    snapshot = {"format_version": SNAPSHOT_KIND.version, **plan["snapshot"]}
    (directory / "snapshot.json").write_text(json.dumps(snapshot))
    _, paper, _ = run_edgectl(directory, "plan", "--snapshot", "snapshot.json", "-o", "json")
    print(f"{size:>6} {whole:>12.1f} {whole / size * 1000:>9.1f} {cpu:>14.1f} {paper:>22.1f}", flush=True)


def measure_apply(directory: Path, size: int) -> None:
    """Print what start and stop of one task on each slice take."""
    for words in (("apply", "--yes"), ("stop", "--all", "--yes")):
        output, whole, cpu = run_edgectl(directory, *words, "-o", "json")
        assert output
        print(f"{size:>6} {words[0]:>6} {whole:>10.1f} s {cpu:>10.2f} s of CPU on the manager", flush=True)


def main(arguments: Sequence[str]) -> int:
    applied = "--apply" in arguments
    sizes = [int(text) for text in arguments if text.isdigit()] or list(SIZES)
    print(f"yardstick: {measure_yardstick():.2f} s, load {os.getloadavg()[0]:.1f}")
    print(f"{'slices':>6} {'plan, s':>12} {'ms/slice':>9} {'manager CPU, s':>14} {'plan --snapshot, s':>22}")
    with (
        tempfile.TemporaryDirectory() as directory,
        running_lab(Path(directory) / "lab", ["machine"]) as lab,
    ):
        for size in sizes:
            measure_fleet(lab, Path(directory) / str(size), size)
            if applied:
                measure_apply(Path(directory) / str(size), size)
    print(f"yardstick: {measure_yardstick():.2f} s, load {os.getloadavg()[0]:.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
