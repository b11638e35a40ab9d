# SPDX-License-Identifier: Apache-2.0
"""Watch over real sshd hosts that lose power in turn and return."""

import os
import tempfile
import time
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.inventory import Inventory, Role
from edgectl.model.plan import Action
from edgectl.model.result import Outcome
from edgectl.usecases.watch import WatchOptions, watch_fleet
from tests.builders import an_inventory, some_tasks
from tests.e2e.bench import a_mark, a_sleeper, a_slice, open_bench
from tests.pace import patience
from tests.soak.resource_readings import ResourceReading, take_reading, take_reading_at_rest
from tests.sshd import MARK, Lab, Server, running_lab
from tests.usecases.watch_site import EVERY, JumpingWait, SteppedClock

NAMES = ("edge1", "edge2", "robot1")


@dataclass(frozen=True, kw_only=True)
class OutageSchedule:
    """A host dies every ``period`` cycles, for ``dead`` cycles; the last ``quiet`` have no faults."""

    period: int = 20
    dead: int = 6
    quiet: int = 14


def build_inventory(lab: Lab) -> Inventory:
    edges = [a_slice(lab.host(name)) for name in ("edge1", "edge2")]
    links = {("edge1", "robot1"): 10e6, ("edge2", "robot1"): 10e6}
    return an_inventory(*edges, a_slice(lab.host("robot1", role=Role.ROBOT)), links=links)


def count_living(lab: Lab) -> int:
    """Count processes on the hosts: sshd sessions, supervisors, tasks and leftovers."""
    marks = tuple(f"{MARK}={server.directory}".encode() for server in lab.servers.values())
    servers = {str(server.process.pid) for server in lab.servers.values() if server.process is not None}
    found = 0
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parent = (path / "stat").read_text(errors="replace").rpartition(")")[2].split()[1]
            environ = (path / "environ").read_bytes().split(b"\0")
            found += parent in servers or any(mark in environ for mark in marks)
    return found


class HostPower:
    """Cuts the power of the hosts in turn: one host at a time, with everything that runs on it."""

    def __init__(self, lab: Lab, cycles: int, rhythm: OutageSchedule) -> None:
        self.lab, self.last, self.rhythm = lab, cycles - rhythm.quiet, rhythm
        self.losses = 0
        self.dead: Server | None = None

    def strike(self, number: int) -> None:
        """Change the power between cycle ``number`` and the next."""
        if self.dead is not None and (number % self.rhythm.period == self.rhythm.dead or number >= self.last):
            self.dead.start()
            self.dead.wait()
            self.dead = None
        elif number % self.rhythm.period == 0 and number < self.last:
            self.dead = self.lab[NAMES[self.losses % len(NAMES)]]
            self.dead.stop()
            self.losses += 1


def soak_ssh_hosts(
    lab: Lab, directory: Path, cycles: int, rhythm: OutageSchedule = OutageSchedule()
) -> tuple[ResourceReading, ResourceReading, dict[str, int]]:
    """Return the readings after the first host has come back and at the end, and the counts of events; all
    tasks run once in the end, and none after the stop.
    """
    marks = {"first": a_mark(), "second": a_mark(), "third": a_mark()}
    tasks = some_tasks(*(a_sleeper(name, mark, robots=("robot1",)) for name, mark in marks.items()))
    hands, warm = SteppedClock(), None
    control = JumpingWait(hands)
    counts = {"moves": 0, "starts": 0, "failed": 0, "errors": 0}
    with open_bench(build_inventory(lab), directory / "manager", lab) as bench:
        power = HostPower(lab, cycles, rhythm)
        made = replace(bench.using(*tasks.tasks.values()).fleet, clock=hands.wall, uptime=hands.uptime)
        options = WatchOptions(
            every=EVERY,
            apply=True,
            cycles=cycles,
            control=control,
            probe=ProbeOptions(window=0.1, timeout=10.0),
        )
        with closing(watch_fleet(made, options)) as running:
            for cycle in running:
                for action in cycle.results.actions if cycle.results is not None else ():
                    counts["moves"] += action.action is Action.MOVE and action.outcome is Outcome.DONE
                    counts["starts"] += action.action is Action.START and action.outcome is Outcome.DONE
                    counts["failed"] += action.outcome is Outcome.FAILED
                counts["errors"] += bool(cycle.error)
                if cycle.number == rhythm.period - 1:
                    warm = take_reading(lambda: count_living(lab))
                if cycle.number == cycles:
                    assert warm is not None
                    end = take_reading_at_rest(warm, lambda: count_living(lab))
                    assert cycle.snapshot is not None
                    alive = [
                        task
                        for host in cycle.snapshot.hosts.values()
                        for task, entry in host.tasks.items()
                        if entry.state.alive
                    ]
                    assert sorted(alive) == sorted(marks), alive
                power.strike(cycle.number)
        counts["losses"] = power.losses
        bench.stop()
    deadline = time.monotonic() + patience(60)
    while count_living(lab) and time.monotonic() < deadline:
        time.sleep(0.1)
    counts["left behind"] = count_living(lab)
    assert warm is not None
    return warm, end, counts


def time_ssh_soak(cycles: int) -> tuple[float, ResourceReading, ResourceReading, dict[str, int]]:
    """Run the soak test on new servers and return its duration in seconds, too."""
    with (
        tempfile.TemporaryDirectory(prefix="edgectl-soak-") as name,
        running_lab(Path(name) / "lab", NAMES) as lab,
    ):
        os.environ.update(lab.environment)
        began = time.monotonic()
        warm, end, counts = soak_ssh_hosts(lab, Path(name), cycles)
        return time.monotonic() - began, warm, end, counts
