"""``make demo``: the main job for real, on three pretend edges and three pretend robots of this machine.

Every command that is printed is run, in a fleet made by ``edgectl init``. Ends with an error if a step did not do what it says.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tests.pace import patience

LIMIT_S = round(patience(280))
EXPECTED_TASKS = 10
SETTLE_S = 2.0
# The map grows to 440 MiB, as a person sees it.
GROWN_BYTES, GROWS_S = 430 * 2**20, patience(30.0)


class DemoError(Exception):
    """A step did not do what it says."""


class Demo:
    """A fleet in a directory of its own; nothing of the user's is read or written."""

    def __init__(self, root: Path) -> None:
        self.fleet = root / "fleet"
        self.state = root / "state"
        kept = {name: value for name, value in os.environ.items() if not name.startswith("EDGECTL_")}
        path = f"{Path(sys.executable).parent}{os.pathsep}{kept.get('PATH', os.defpath)}"
        self.env = {**kept, "EDGECTL_STATE_DIR": str(self.state), "PATH": path}

    def run(self, *words: str, shown: bool = True, code: int = 0) -> str:
        """Run one edgectl command; show it and its output as a terminal would."""
        if shown:
            say(f"\n$ edgectl {' '.join(words)}")
        directory = self.fleet if self.fleet.exists() else self.fleet.parent
        done = subprocess.run(
            [sys.executable, "-m", "edgectl", *words],
            env=self.env,
            cwd=directory,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        if shown:
            say(done.stdout.rstrip())
        must(done.returncode == code, f"edgectl {' '.join(words)} ended with {done.returncode}, not {code}")
        return done.stdout

    def places(self) -> dict[str, tuple[str, int]]:
        """Host and pid of every task that is alive."""
        document: dict[str, Any] = json.loads(self.run("status", "-o", "json", shown=False))
        return {
            row["task"]: (row["host"], row["pid"])
            for row in document["items"]
            if row["state"] in ("starting", "running", "ready")
        }

    def processes(self) -> list[int]:
        """Every process that was started on behalf of this fleet: its environment names our state directory."""
        mark = f"EDGECTL_STATE_DIR={self.state}".encode()
        found = []
        for entry in Path("/proc").glob("[0-9]*/environ"):
            try:
                if mark in entry.read_bytes().split(b"\0"):
                    found.append(int(entry.parent.name))
            except OSError:
                continue
        return found


def say(text: str) -> None:
    """Print at once, so that the output keeps its order."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def must(true: object, message: str) -> None:
    """Fail the demo where it did not do what it says."""
    if not true:
        raise DemoError(message)


def resident(pid: int) -> int:
    """Bytes of memory that a process really has."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def bring_up(demo: Demo) -> None:
    """From files to running tasks."""
    say("# A fleet to try: three pretend edges, three pretend robots, the tasks of the paper's scenario 2.")
    demo.run("init", str(demo.fleet))
    demo.run("validate")
    demo.run("probe")
    must("10 to start" in demo.run("plan"), "the plan does not start ten tasks")
    must(
        f"Applied {EXPECTED_TASKS} of {EXPECTED_TASKS}" in demo.run("apply", "--yes"),
        "not every task was started",
    )
    time.sleep(SETTLE_S)
    demo.run("status")
    must(len(demo.places()) == EXPECTED_TASKS, "not every task runs")


def grow(demo: Demo) -> str:
    """Make the SLAM beside robot1's detection really hold more memory; the task that has to leave."""
    places = demo.places()
    task = "detection-robot1"
    edge = places[task][0]
    slam = f"slam-robot{edge.removeprefix('edge')}"
    say(
        f"\n# The map of {slam} grows: it now really holds 440 of the 512 MiB of {edge}. It is pinned; its neighbour {task} must move."
    )
    say(f"$ kill -USR1 {places[slam][1]}")
    os.kill(places[slam][1], signal.SIGUSR1)
    deadline = time.monotonic() + GROWS_S
    while resident(places[slam][1]) < GROWN_BYTES and time.monotonic() < deadline:
        time.sleep(0.1)
    return task


def move(demo: Demo, task: str) -> None:
    """Plan and apply the move, and see that it happened."""
    before = demo.places()[task][0]
    must(f"~  {task}" in demo.run("plan", "-o", "wide"), f"the plan does not move {task}")
    must(f"~  {task}" in demo.run("apply", "--yes"), f"{task} was not moved")
    time.sleep(SETTLE_S)
    after = demo.places()
    must(len(after) == EXPECTED_TASKS, "not every task runs after the move")
    must(after[task][0] != before, f"{task} still runs on {before}")
    say(f"\n# {task} moved from {before} to {after[task][0]}.")
    must("No changes." in demo.run("plan"), "a plan right after the apply changes something")


def take_down(demo: Demo) -> None:
    """Stop everything, and prove it."""
    must("to stop" in demo.run("stop", "--all", "--yes"), "nothing was stopped")
    must(demo.run("status", "-o", "name", shown=False) == "", "a task still runs")
    left = demo.processes()
    must(not left, f"processes are left: {left}")
    say("\n# No task runs, and no process of this fleet is left.")


def clean(demo: Demo) -> None:
    """Whatever happened, leave nothing behind."""
    for pid in demo.processes():
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


def late(_signal: int, _frame: object) -> None:
    """End a demo that takes too long."""
    raise DemoError(f"it took more than {LIMIT_S} s")


def main() -> int:
    """Run all of it."""
    signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT_S)
    began = time.monotonic()
    root = Path(tempfile.mkdtemp(prefix="edgectl-demo-"))
    demo = Demo(root)
    try:
        bring_up(demo)
        move(demo, grow(demo))
        take_down(demo)
    except DemoError as error:
        sys.stderr.write(f"demo failed: {error}\n")
        return 1
    finally:
        signal.alarm(0)
        clean(demo)
        shutil.rmtree(root, ignore_errors=True)
    say(f"# Done in {time.monotonic() - began:.0f} s.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
