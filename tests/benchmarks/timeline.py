# SPDX-License-Identifier: Apache-2.0
"""Time of a probe by milestone: ``python -m tests.benchmarks.timeline [N ..]``.

``edgectl probe`` of N real SSH servers of this machine, whole process, with new connections and with the agent on the
hosts already: wall time and CPU of the manager at each milestone, medians of several runs.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.benchmarks.whole_commands import write_inventory
from tests.sshd import Lab, running_lab

SIZES = (3, 64)
RUNS = 7
MILESTONES = {
    "python": "Python has started",
    "connect": "first connection: imports, files, ssh -G",
    "login": "last login: key exchanges, host keys, keys",
    "reply": "last reply: requests, agents",
    "end": "output: snapshot, state, history, table",
    "exit": "the process has ended",
}
# Notes wall and CPU time at the milestones. What sends requests is found once it has been imported by edgectl.
PROGRAM = """
import json, os, sys, time
began, marks = float(os.environ["TIMELINE_BEGAN"]), {}
def note(name):
    marks[name] = time.time() - began, time.process_time()
note("python")
def listen(event, args):
    if event == "socket.connect" and "connect" not in marks and isinstance(args[1], tuple):
        note("connect")
        fanout = sys.modules["edgectl.gateway.fanout"]
        ask = fanout.call_agent
        def call(*args, **options):
            note("login")
            try:
                return ask(*args, **options)
            finally:
                note("reply")
        fanout.call_agent = call
sys.addaudithook(listen)
from edgectl.cli.main import main
assert main() == 0
note("end")
with open(os.environ["TIMELINE_REPORT"], "w") as report:
    json.dump(marks, report)
os._exit(0)  # as edgectl.cli.main.run ends
"""


def run_probe(lab: Lab, folder: Path) -> dict[str, tuple[float, float]]:
    """Return seconds of wall time and of CPU at each milestone."""
    environment = os.environ | lab.environment | {"EDGECTL_STATE_DIR": str(folder / "state")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    report = folder / "timeline.json"
    command = [sys.executable, "-c", PROGRAM, "probe", "--window", "0", "--timeout", "2m"]
    began = time.time()
    environment |= {"TIMELINE_BEGAN": repr(began), "TIMELINE_REPORT": str(report)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    ended = time.time() - began
    assert done.returncode == 0, done.stderr
    marks: dict[str, tuple[float, float]] = json.loads(report.read_text())
    return {**marks, "exit": (ended, marks["end"][1])}


def print_timeline(runs: Sequence[dict[str, tuple[float, float]]], size: int) -> None:
    """Print when each milestone is reached, and what has passed since the one before."""
    print(f"{size} hosts{'at, ms':>50}{'since, ms':>11}{'CPU, ms':>9}{'since, ms':>11}")
    before = 0.0, 0.0
    for name, words in MILESTONES.items():
        at, cpu = (statistics.median(run[name][which] for run in runs) * 1000 for which in (0, 1))
        print(f"  {words:<48}{at:>7.0f}{at - before[0]:>11.0f}{cpu:>9.0f}{cpu - before[1]:>11.0f}")
        before = at, cpu


def main(words: Sequence[str]) -> int:
    """Print the tables."""
    sizes = [int(word) for word in words] or list(SIZES)
    with tempfile.TemporaryDirectory(prefix="edgectl-") as directory:
        folder = Path(directory)
        with running_lab(folder / "lab", [f"edge{n}" for n in range(1, max(sizes) + 1)]) as lab:
            for size in sizes:
                write_inventory(folder, list(lab.servers)[:size])
                run_probe(lab, folder)  # installs the agent on hosts that lack it
                print_timeline([run_probe(lab, folder) for _ in range(RUNS)], size)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
