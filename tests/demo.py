# SPDX-License-Identifier: Apache-2.0
"""``make demo``: a whole deployment on three simulated edges and three simulated robots of this machine.

Every printed command is run, in a fleet made by ``edgectl init``. Ends with an error if a step fails.
"""

import contextlib
import fcntl
import json
import os
import pty
import re
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import textwrap
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from edgectl.rules.measured_demand import WARM_UP_S
from tests.forkserver import ForkedProcess
from tests.pace import patience

LIMIT_S = round(patience(280))
EXPECTED_TASKS = 10
# FORCE_COLOR colours what is shown; the checks read words.
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
SETTLE_S = 2.0
# The map grows to 440 MiB, in edgectl's units.
GROWN_BYTES, GROWS_S = 430 * 2**20, patience(30.0)


class DemoError(Exception):
    """A step had the wrong result."""


class Demo:
    """A fleet in a directory of its own; no file of the user is read or written."""

    def __init__(self, root: Path) -> None:
        self.fleet = root / "fleet"
        self.state = root / "state"
        kept = {name: value for name, value in os.environ.items() if not name.startswith("EDGECTL_")}
        path = f"{Path(sys.executable).parent}{os.pathsep}{kept.get('PATH', os.defpath)}"
        self.env = {**kept, "EDGECTL_STATE_DIR": str(self.state), "PATH": path}

    def run(self, *words: str, shown: bool = True, code: int = 0) -> str:
        """Run one edgectl command; print it and its output as a terminal would."""
        if shown:
            print_line(f"\n$ edgectl {' '.join(words)}")
        directory = self.fleet if self.fleet.exists() else self.fleet.parent
        if shown and is_watched():
            out, ended = self._run_on_terminal(words, directory)
        else:
            with ForkedProcess(words, env=self.env, cwd=directory, stdout=subprocess.PIPE) as process:
                out, _ = process.communicate()
            ended = process.returncode
            if shown:
                print_line(out.rstrip())
        require(ended == code, f"edgectl {' '.join(words)} ended with {ended}, not {code}")
        return COLOUR.sub("", out)

    def _run_on_terminal(self, words: Sequence[str], directory: Path) -> tuple[str, int]:
        """Run it on a terminal as wide as this one, so that tables fit; its output, which is shown, and exit code."""
        ours, theirs = pty.openpty()
        size = os.get_terminal_size(sys.stdout.fileno())
        attributes = termios.tcgetattr(theirs)
        attributes[1] &= ~termios.OPOST  # carriage returns are added by the terminal that shows it
        termios.tcsetattr(theirs, termios.TCSANOW, attributes)
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", size.lines, size.columns, 0, 0))
        with ForkedProcess(words, env=self.env, cwd=directory, stdout=theirs, stderr=theirs) as process:
            os.close(theirs)
            seen = b""
            with contextlib.suppress(OSError):  # the program has ended, and so has its side of the terminal
                while data := os.read(ours, 1 << 16):
                    seen += data
                    os.write(sys.stdout.fileno(), data)
        os.close(ours)
        return seen.decode(errors="replace"), process.returncode

    def places(self) -> dict[str, tuple[str, int]]:
        """Return host and pid of every live task."""
        document: dict[str, Any] = json.loads(self.run("status", "-o", "json", shown=False))
        return {
            row["task"]: (row["host"], row["pid"])
            for row in document["items"]
            if row["state"] in ("starting", "running", "ready")
        }

    def run_time(self, task: str) -> float:
        """Return how long a task has run, in seconds."""
        document: dict[str, Any] = json.loads(self.run("status", "-o", "json", shown=False))
        (age_s,) = [row["age_s"] for row in document["items"] if row["task"] == task]
        return float(age_s)

    def processes(self) -> list[int]:
        """List every process started for this fleet: its environment names our state directory."""
        mark = f"EDGECTL_STATE_DIR={self.state}".encode()
        found = []
        for entry in Path("/proc").glob("[0-9]*/environ"):
            try:
                if mark in entry.read_bytes().split(b"\0"):
                    found.append(int(entry.parent.name))
            except OSError:
                continue
        return found


def is_watched() -> bool:
    """Whether someone looks at a terminal; a recording has one for standard output alone."""
    return sys.stdout.isatty() and sys.stderr.isatty()


def comment(text: str) -> None:
    """Print what the demo says of itself; on a terminal no word is split."""
    width = os.get_terminal_size(sys.stdout.fileno()).columns if is_watched() else 0
    for line in textwrap.wrap(text, max(20, width - 2)) if width else [text]:
        print_line(f"# {line}")


def print_line(text: str) -> None:
    """Print at once, so that the output keeps its order."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def require(true: object, message: str) -> None:
    """End the demo with an error unless the condition holds."""
    if not true:
        raise DemoError(message)


def read_resident_bytes(pid: int) -> int:
    """Return the resident memory of a process in bytes."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def start_fleet(demo: Demo) -> None:
    """Create the files and start the tasks."""
    comment(
        "A fleet to try: three simulated edges, three simulated robots, the tasks of the paper's scenario 2."
    )
    demo.run("init", str(demo.fleet))
    demo.run("validate")
    demo.run("probe")
    require("10 to start" in demo.run("plan"), "the plan does not start ten tasks")
    require(
        f"Applied {EXPECTED_TASKS} of {EXPECTED_TASKS}" in demo.run("apply", "--yes"),
        "not every task was started",
    )
    time.sleep(SETTLE_S)
    demo.run("status")
    require(len(demo.places()) == EXPECTED_TASKS, "not every task runs")


def grow_map(demo: Demo) -> str:
    """Make the SLAM beside robot1's detection hold more memory; return the task that has to leave."""
    places = demo.places()
    task = "detection-robot1"
    edge = places[task][0]
    slam = f"slam-robot{edge.removeprefix('edge')}"
    print_line("")
    comment(
        f"The map of {slam} grows: it now really holds 440 of the 512 MiB of {edge}. It is pinned; its neighbour {task} must move."
    )
    print_line(f"$ kill -USR1 {places[slam][1]}")
    os.kill(places[slam][1], signal.SIGUSR1)
    deadline = time.monotonic() + GROWS_S
    while read_resident_bytes(places[slam][1]) < GROWN_BYTES and time.monotonic() < deadline:
        time.sleep(0.1)
    comment(f"What a task uses counts when it has run {WARM_UP_S:g} s.")
    while demo.run_time(slam) < WARM_UP_S and time.monotonic() < deadline:
        time.sleep(0.5)
    return task


def move_task(demo: Demo, task: str) -> None:
    """Plan and apply the move, and check its result."""
    before = demo.places()[task][0]
    require(f"~  {task}" in demo.run("plan", "-o", "wide"), f"the plan does not move {task}")
    require(f"~  {task}" in demo.run("apply", "--yes"), f"{task} was not moved")
    time.sleep(SETTLE_S)
    after = demo.places()
    require(len(after) == EXPECTED_TASKS, "not every task runs after the move")
    require(after[task][0] != before, f"{task} still runs on {before}")
    print_line(f"\n# {task} moved from {before} to {after[task][0]}.")
    require("No changes." in demo.run("plan"), "a plan right after the apply changes something")


def stop_fleet(demo: Demo) -> None:
    """Stop everything, and check that nothing is left."""
    require("to stop" in demo.run("stop", "--all", "--yes"), "nothing was stopped")
    require(demo.run("status", "-o", "name", shown=False) == "", "a task still runs")
    left = demo.processes()
    require(not left, f"processes are left: {left}")
    print_line("\n# No task runs, and no process of this fleet is left.")


def kill_leftovers(demo: Demo) -> None:
    """Kill leftover processes, whatever happened."""
    for pid in demo.processes():
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


def raise_timeout(_signal: int, _frame: object) -> None:
    """End a demo that takes too long."""
    raise DemoError(f"it took more than {LIMIT_S} s")


def main() -> int:
    """Run all steps."""
    signal.signal(signal.SIGALRM, raise_timeout)
    signal.alarm(LIMIT_S)
    began = time.monotonic()
    root = Path(tempfile.mkdtemp(prefix="edgectl-demo-"))
    demo = Demo(root)
    try:
        start_fleet(demo)
        move_task(demo, grow_map(demo))
        stop_fleet(demo)
    except DemoError as error:
        sys.stderr.write(f"demo failed: {error}\n")
        return 1
    finally:
        signal.alarm(0)
        kill_leftovers(demo)
        shutil.rmtree(root, ignore_errors=True)
    print_line(f"# Done in {time.monotonic() - began:.0f} s.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
