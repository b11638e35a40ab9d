# SPDX-License-Identifier: Apache-2.0
"""CPU time of commands over SSH on the manager: ``python -m tests.benchmarks.manager_start``.

Each command runs whole against real SSH servers of this machine: CPU until its first connection to a host, and until
its end. Its imports are measured alone, in processes that import the same modules in the same order and do nothing
else; both take modules from the file that earlier runs have written. All kinds of process run in turns.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.benchmarks.ratios import note_ratio
from tests.sshd import running_lab

RUNS = 5
# Milliseconds of CPU for the imports of a command, the start of Python included.
GOAL_MS = 120.0
COMMANDS = {
    "probe": ("probe", "--window", "0"),
    "plan": ("plan",),
    "apply": ("apply", "-y"),
}
# Runs edgectl; writes down its modules in their order, and its CPU time at the first connection and at the end.
PROGRAM = """
import json, os, sys, time
first = []
def listen(event, args):
    if event == "socket.connect" and not first and isinstance(args[1], tuple):
        first.append(time.process_time())
sys.addaudithook(listen)
from edgectl.cli.main import run
try:
    run()
except SystemExit as end:
    with open(os.environ["START_REPORT"], "w") as report:
        json.dump({"code": end.code, "first": first[0], "end": time.process_time(), "modules": list(sys.modules)}, report)
"""
# Imports what a command did. Modules that others set up, such as typing.io, cannot be imported by their name.
IMPORTS = """
import json, os, sys, time
from importlib import import_module
from edgectl.cli.main import _postpone_garbage_collection
from edgectl.deferred_imports import DEFERRED_MODULES, import_deferred
from edgectl.module_cache import install_module_cache
_postpone_garbage_collection()
install_module_cache()
with open(os.environ["START_REPORT"]) as report:
    names = json.load(report)["modules"]
for name in DEFERRED_MODULES.keys() & set(names):
    import_deferred(name)
for name in names:
    if name not in sys.modules:
        try:
            import_module(name)
        except ImportError:
            pass
print(time.process_time())
"""
PEERS = {"python -c pass": "pass", "import typer": "import typer.main", "import paramiko": "import paramiko"}
END = "\nimport time; print(time.process_time())"
HEAD = ("what", "imports", "first connection", "end", "modules")


def measure_process_ms(source: str, folder: Path, env: dict[str, str], *words: str) -> float:
    """Return the CPU time that a process prints."""
    command = [sys.executable, "-c", source, *words]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return float(done.stdout.split()[-1]) * 1000


def run_edgectl(folder: Path, env: dict[str, str], words: Sequence[str]) -> dict[str, float]:
    """Run a command; return its CPU times (ms) and the number of its modules."""
    command = [sys.executable, "-c", PROGRAM, *words]
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads(Path(env["START_REPORT"]).read_text())
    assert report["code"] == 0, (words, report["code"], done.stderr)
    return {
        "first": report["first"] * 1000,
        "end": report["end"] * 1000,
        "modules": len(report["modules"]),
        "imports": measure_process_ms(IMPORTS, folder, env),
    }


def write_fleet(folder: Path, hosts: Sequence[str]) -> None:
    (folder / "inventories").mkdir()
    (folder / "tasks").mkdir()
    # Slices: all servers are on one machine, of which a plan would refuse two whole hosts.
    edges = "".join(f"  {name}: {{host: {name}, capacity: {{cpu: 2, memory: 4Gi}}}}\n" for name in hosts)
    (folder / "inventories" / "lab.yaml").write_text(
        f"version: 1\nfleet: start\nedges:\n{edges}robots:\n  robot1: {{host: 127.0.0.1, probe: false}}\n"
    )
    (folder / "tasks" / "lab.yaml").write_text(
        "version: 1\ntasks:\n  beat: {robot: robot1, command: sleep 1000, demand: {cpu: 0, memory: 0, throughput: 0}}\n"
    )


def measure_commands(folder: Path, env: dict[str, str]) -> dict[str, dict[str, list[float]]]:
    """Run everything ``RUNS`` times in turns."""
    found: dict[str, dict[str, list[float]]] = {}
    for turn in range(-2, RUNS):
        for name, source in PEERS.items():
            value = measure_process_ms(source + END, folder, env)
            if turn >= 0:
                found.setdefault(name, {}).setdefault("imports", []).append(value)
        for name, words in COMMANDS.items():
            for column, value in run_edgectl(folder, env, words).items():
                if turn >= 0:
                    found.setdefault(f"edgectl {name}", {}).setdefault(column, []).append(value)
    return found


def print_table(found: dict[str, dict[str, list[float]]]) -> bool:
    """Print least and median CPU; return whether the imports of every command are within the goal."""
    print(f"{HEAD[0]:<20}{HEAD[1]:>16}{HEAD[2]:>20}{HEAD[3]:>16}{HEAD[4]:>9}   (CPU ms: least, median)")
    for name, columns in found.items():
        cells = [
            f"{min(values):.0f}, {statistics.median(values):.0f}" if (values := columns.get(column)) else ""
            for column in ("imports", "first", "end")
        ]
        modules = f"{columns['modules'][-1]:.0f}" if "modules" in columns else ""
        print(f"{name:<20}{cells[0]:>16}{cells[1]:>20}{cells[2]:>16}{modules:>9}")
    for name, columns in found.items():
        if name.startswith("edgectl"):
            note_ratio(
                f"imports of {name}, CPU", min(columns["imports"]) / GOAL_MS, of=f"{GOAL_MS:g} ms", most=1.0
            )
            peer = min(found["import paramiko"]["imports"])
            note_ratio(f"imports of {name}, CPU", min(columns["imports"]) / peer, of="import paramiko")
    worst = max(min(columns["imports"]) for name, columns in found.items() if name.startswith("edgectl"))
    print(f"imports of a command: at most {worst:.0f} ms (goal {GOAL_MS:.0f})")
    return worst <= GOAL_MS


def main() -> int:
    """Print the table; return 1 if the goal is missed."""
    with tempfile.TemporaryDirectory(prefix="edgectl-") as name:
        folder = Path(name)
        hosts = ["edge3", "edge2", "edge1"]
        write_fleet(folder, hosts)
        with running_lab(folder / "lab", hosts) as lab:
            env = os.environ | lab.environment | {"EDGECTL_STATE_DIR": str(folder / "state")}
            env["START_REPORT"] = str(folder / "report.json")
            env.pop("PYTHONDONTWRITEBYTECODE", None)
            try:
                found = measure_commands(folder, env)
            finally:
                subprocess.run(
                    [sys.executable, "-m", "edgectl", "stop", "--all", "-y"], cwd=folder, env=env, check=False
                )
    return int(not print_table(found))


if __name__ == "__main__":
    sys.exit(main())
