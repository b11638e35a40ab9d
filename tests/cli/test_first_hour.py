# SPDX-License-Identifier: Apache-2.0
"""Ten stories of the first hour with edgectl: what a new user tries, and the exact words and exit codes that answer.

The installed command in a home of its own, with no more of an environment than a cron job has, and real tasks on this
machine; in the order of a day in the lab.
"""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.state.lock import describe_manager
from tests.cli.inprocess import Said
from tests.compiled_agent import give_agent_and_keys
from tests.leftovers import end_started_in
from tests.pace import patience

INSTALLED = str(Path(sys.executable).parent / "edgectl")

EDGE = "{host: 127.0.0.1, connection: local, capacity: {cpu: 2, memory: 1Gi}}"
# Reverse alphabetical, as nobody sorts a lab.
INVENTORY = f"version: 1\n{{fleet}}edges:\n  edge2: {EDGE}\n  edge1: {EDGE}\n"
DEMAND = "demand: {cpu: 0.1, memory: 10Mi}, up: 100ms, stop: {grace: 2s}"
SLAM = f'  slam: {{command: "exec sleep 600", {DEMAND}}}\n'
NAMED = "fleet: lab\n"


class Lab:
    """A folder on the way to be a fleet, and somebody who types there."""

    def __init__(self, folder: Path, home: Path) -> None:
        self.folder, self.home = folder, home
        self.here = folder

    @property
    def state(self) -> Path:
        """Where the command keeps its records by itself."""
        return self.home / ".local" / "state" / "edgectl"

    def run(self, *words: str) -> Said:
        done = subprocess.run(
            [INSTALLED, *words],
            cwd=self.here,
            env={"HOME": str(self.home), "PATH": f"{Path(INSTALLED).parent}:/usr/bin:/bin"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=patience(60),
        )
        return Said(done.returncode, done.stdout, done.stderr)

    def write(self, *tasks: str, fleet: str = NAMED, inventory: str = "inventories/lab.yaml") -> None:
        self.put(inventory, INVENTORY.replace("{fleet}", fleet))
        self.put("tasks/lab.yaml", "version: 1\ntasks:\n" + "".join(tasks))
        self.give_keys(inventory)

    def give_keys(self, inventory: str) -> None:
        """Give this machine the compiled agent, and the manager the key of the fleet, to save CPU time."""
        self.state.mkdir(parents=True, mode=0o700, exist_ok=True)
        give_agent_and_keys(self.state, self.folder / inventory)

    def put(self, name: str, text: str) -> None:
        (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / name).write_text(text)

    def pids(self) -> dict[str, str]:
        """The process of each running task."""
        lines = self.run("get", "tasks", "-o", "wide").out.splitlines()
        column = lines[0].index("PID")
        rows = [(line.split()[0], line[: column + 3].split()[-1]) for line in lines[1:]]
        return {task: pid for task, pid in rows if pid.isdigit()}


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    for name in ("home", "lab"):
        (tmp_path / name).mkdir()
    try:
        yield Lab(tmp_path / "lab", tmp_path / "home")
    finally:
        end_started_in([tmp_path])


def test_1_an_inventory_and_nothing_else(lab: Lab) -> None:
    """Do my computers answer? What runs is asked later."""
    lab.put("inventories/lab.yaml", INVENTORY.replace("{fleet}", NAMED))
    said = lab.run("get", "edges")
    assert (said.code, [line.split()[:2] for line in said.out.splitlines()]) == (
        0,
        [["HOST", "STATUS"], ["edge1", "ok"], ["edge2", "ok"]],
    )
    assert lab.run("trust", "--all", "--yes") == (
        0,
        "",
        "note: no host here has a host key: all are this machine, or never contacted\n",
    )
    assert lab.run("plan") == (
        64,
        "",
        "error: no task file given, and there is none in tasks/\nhint: pass -t FILE, or write tasks/lab.yaml\n",
    )


def test_2_the_wrong_folder(lab: Lab) -> None:
    """Below the fleet, above it, and where there is none."""
    lab.write(SLAM)
    error = "error: no inventory given, and there is none in inventories/\nhint: pass -i FILE, or "
    lab.here = lab.folder / "tasks"
    marked = f"mark {lab.folder} as the project: echo 'version: 1' > ../edgectl.yaml\n"
    assert lab.run("status") == (64, "", error + marked)
    lab.put("edgectl.yaml", "version: 1\n")
    assert lab.run("validate") == (0, "ok: 2 edges, 0 robots, 1 task\n", "")
    (lab.folder / "deep" / "empty").mkdir(parents=True)
    (lab.folder / "edgectl.yaml").rename(lab.folder / "tasks" / "edgectl.yaml")
    (lab.folder / "inventories").rename(lab.folder / "tasks" / "inventories")
    lab.here = lab.folder
    assert lab.run("status") == (64, "", error + "enter the folder of the fleet: cd tasks\n")
    lab.here = lab.folder / "deep" / "empty"
    assert lab.run("status") == (64, "", error + "create an example fleet: edgectl init .\n")


def test_3_the_inventory_is_renamed(lab: Lab) -> None:
    """A fleet without a stated name lives by the path of its file: what runs is not started a second time."""
    lab.write(SLAM, fleet="")
    assert lab.run("apply", "--yes").code == 0
    before = lab.pids()
    first = re.search(r"hint: add fleet: (lab-[0-9a-f]{8})\n", lab.run("validate").err)
    assert first is not None
    (lab.folder / "inventories" / "lab.yaml").rename(lab.folder / "inventories" / "hall.yaml")
    lab.give_keys("inventories/hall.yaml")
    message = (
        rf"edge[12] runs slam of fleet {first[1]}, started by you; no fleet is stated here: it would be started a "
        "second time"
    )
    hint = f"hint: add fleet: {first[1]} to the inventory; if that is another fleet, add a name of its own\n"
    planned = lab.run("plan")
    assert planned.code == 0
    assert re.search(f"warning: {message}", planned.err)
    assert hint in planned.err
    applied = lab.run("apply", "--yes")
    assert (applied.code, applied.out) == (64, "")
    assert re.search(rf"error: {message}\n{re.escape(hint)}$", applied.err), applied.err
    lab.put("inventories/hall.yaml", INVENTORY.replace("{fleet}", f"fleet: {first[1]}\n"))
    assert lab.run("apply", "--yes").code == 0
    assert lab.pids() == before


def test_4_a_second_machine(lab: Lab) -> None:
    """The repository is cloned on another manager, which has no state: it finds what runs, and keeps it."""
    lab.write(SLAM)
    assert lab.run("apply", "--yes").code == 0
    before = lab.pids()
    assert before.keys() == {"slam"}
    place = lab.state / "fleets" / "lab"
    place.rename(lab.folder / "the-other-machine")
    again = lab.run("apply", "--yes")
    assert (again.code, again.out.splitlines()[-1]) == (0, "No changes. 1 task is where it should be.")
    assert re.fullmatch(
        r"warning: edge[12] runs slam, but no record here places it there: it is taken over\n", again.err
    )
    assert lab.pids() == before


def test_5_a_student_beside_a_student(lab: Lab) -> None:
    """One login, the same host names, two fleets: each sees the other's tasks, and touches none."""
    lab.write(SLAM)
    assert lab.run("apply", "--yes").code == 0
    mine = lab.pids()
    other = lab.folder / "paula"
    other.mkdir()
    paula = Lab(other, lab.home)
    paula.write(SLAM, fleet="fleet: paula\n")
    note = (
        f"fleet lab ({describe_manager()}) runs slam; it is left alone, and counts as load except on a slice"
    )
    assert note in " ".join(paula.run("status").err.split())
    assert paula.run("apply", "--yes").code == 0
    assert paula.run("stop", "--all", "--yes").code == 0
    assert paula.run("stop", "--all", "--yes") == (0, "No changes.\n", "")
    assert lab.pids() == mine


def test_6_cron_and_a_task_that_dies(lab: Lab) -> None:
    """`apply --yes --quiet`, every five minutes: one mail, not one each time, and the state stays wrong."""
    quiet = ("apply", "--yes", "--quiet")
    lab.write(
        f"  slam: {{command: 'echo lost >&2; exit 3', restart: never, {DEMAND.replace('100ms', '10ms')}}}\n"
    )
    lab.run(*quiet)
    first, second = lab.run(*quiet), lab.run(*quiet)
    assert (first.code, first.out) == (4, "")
    assert re.fullmatch(
        r"slam is given up on edge[12]; edgectl restart slam, or a changed spec, starts it again\n", first.err
    )
    assert (second.code, second.out, second.err) == (4, "", "")
    status = lab.run("status")
    assert status.code == 4
    said = "Fleet lab, 0/1 tasks run, 2/2 hosts answer, 1 problem:\n1 of 1 tasks failed: slam on edge[12], given up\n"
    assert re.match(said, status.out), status.out
    assert re.search(r"^slam +edge[12] +failed \(exited with 3\) ", status.out, re.MULTILINE)


def test_7_a_computer_is_switched_off(lab: Lab) -> None:
    """Port 1 of this machine: nobody listens there. What may run there is neither lost nor started elsewhere."""
    lab.write(SLAM)
    lab.put(
        "inventories/lab.yaml",
        (lab.folder / "inventories" / "lab.yaml").read_text() + "  edge3: {host: 127.0.0.1, port: 1}\n",
    )
    said = lab.run("get", "edges")
    assert said.code == 4
    assert "edge3 does not answer" in " ".join(said.err.split())
    assert lab.run("get", "edges", "--allow-unreachable").code == 0
    assert lab.run("move", "slam", "edge3").err == (
        "error: slam was not moved: edge3 does not answer\nhint: edgectl doctor edge3\n"
    )
    assert lab.run("fence", "edge3", "--yes").out.startswith("edge/edge3 fenced")
    assert lab.run("get", "edges").code == 0


def test_8_a_slip_of_the_finger(lab: Lab) -> None:
    """In a verb, a name, an option and a file: the word that was meant."""
    lab.write(SLAM.replace("demand", "demnd"))
    assert lab.run("plna").err == "error: No such command 'plna'\nhint: did you mean plan or replay?\n"
    assert lab.run("-i", "inventories/lab.yaml", "plan").err == (
        "error: No such option: -i\nhint: options follow the command: edgectl plan -i inventories/lab.yaml\n"
    )
    said = lab.run("validate")
    assert said.code == 64
    assert "tasks/lab.yaml:3:" in said.err
    assert "unknown key demnd in task slam" in said.err
    assert "hint: did you mean demand?" in said.err
    lab.write(SLAM)
    assert lab.run("explain", "slma").err == "error: unknown task 'slma'\nhint: did you mean slam?\n"


def test_9_a_program_that_goes_to_the_background(lab: Lab) -> None:
    """A trailing & makes the shell end at once: said before it runs, and silenced by who means it."""
    lab.write("  slam:\n    command: sleep 600 &\n    demand: {cpu: 0.1, memory: 10Mi}\n")
    said = lab.run("validate")
    assert said.code == 0
    assert "warning[EC106]: tasks/lab.yaml:4:" in said.err
    path = lab.folder / "tasks" / "lab.yaml"
    path.write_text(path.read_text().replace("sleep 600 &\n", "sleep 600 &  # edgectl: ignore EC106\n"))
    assert lab.run("validate") == (0, "ok: 2 edges, 0 robots, 1 task\n", "")


def test_10_put_this_task_there_now(lab: Lab) -> None:
    """move, apply, unpin; and one saved plan, which is applied once."""
    lab.write(SLAM)
    assert lab.run("plan", "--out", "next.plan").code == 0
    assert lab.run("apply", "next.plan").code == 0
    again = lab.run("apply", "next.plan")
    assert (again.code, again.err) == (
        75,
        "error: saved plan is stale; since it was made:\n  it was applied before\nhint: make a new plan: edgectl plan --out PLAN\n",
    )
    here = lab.run("get", "tasks", "--field", "host").out.strip()
    there = {"edge1": "edge2", "edge2": "edge1"}[here]
    moved = lab.run("move", "slam", there)
    assert moved == (
        0,
        f"task/slam pinned to {there}\n",
        f"next apply: move: pinned to {there} by edgectl move\n",
    )
    assert lab.run("apply", "--yes").code == 0
    assert lab.run("get", "tasks", "--field", "host").out == f"{there}\n"
    assert lab.run("unpin", "slam").out == "task/slam unpinned\n"
