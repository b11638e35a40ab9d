# SPDX-License-Identifier: Apache-2.0
"""Watch over simulated hosts that die, return, lose tasks and refuse actions, on a clock that jumps."""

import random
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edgectl.errors import RefusedError
from edgectl.model.plan import Action
from edgectl.model.result import Outcome
from edgectl.model.task import Tasks
from tests.builders import a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.soak.resource_readings import ResourceReading, take_reading, take_reading_at_rest
from tests.usecases.watch_site import WatchSite

EDGES = ("edge1", "edge2", "edge3")
# Last cycles, without faults: longer than the rest period of a failed task, or a share of a short run.
QUIET = 150
# Warm-up as a share of the cycles: memory peaks while the journal is read; it is rotated at 1 MiB, after some
# 4,800 cycles.
WARM_AT = 0.6


def build_tasks() -> Tasks:
    return some_tasks(
        a_task("slam", cpu=1.0, robots=["robot1"]),
        a_task("navigation", cpu=0.3, robots=["robot1"], needs=["slam"]),
        a_task("detection", cpu=1.5, memory=2**20, robots=["robot1"]),
        a_task("merge", cpu=0.2),
    )


@contextmanager
def open_memory_directory() -> Iterator[Path]:
    """Directory for the state, in memory if possible: the loop is measured, not the disk."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        yield Path(name)


class FleetTrouble:
    """Faults of the fleet, drawn from a seed. All are repaired before the last ``quiet`` cycles."""

    def __init__(self, site: WatchSite, cycles: int, quiet: int, seed: int) -> None:
        self.site, self.dice, self.last = site, random.Random(seed), cycles - quiet
        self.back: dict[str, int] = {}
        self.losses = 0

    def strike(self, number: int) -> None:
        """Change faults between cycle ``number`` and the next."""
        hosts = self.site.hosts
        hosts.world.events.clear()
        for name in [name for name, when in self.back.items() if number >= when or number >= self.last]:
            hosts.down.discard(name)
            del self.back[name]
        for name in EDGES:
            hosts[name].used = (
                min(3.0, max(0.0, hosts[name].used + self.dice.uniform(-0.4, 0.4)))
                if number < self.last
                else 0.5
            )
        if number < self.last and number % 7:
            return
        for name in EDGES:
            hosts[name].faults.clear()
        if number >= self.last:
            return
        name = self.dice.choice((*EDGES, "robot1"))
        match self.dice.randrange(4):
            case 0 if not hosts.down:
                hosts.down.add(name)
                self.back[name] = number + self.dice.randrange(1, 40)
                self.losses += 1
            case 1:
                self._end_a_task(name)
            case 2:
                self._end_a_task(name)
                for edge in EDGES:
                    hosts[edge].faults["start"] = RefusedError("disk full")

    def _end_a_task(self, name: str) -> None:
        hosts = self.site.hosts
        if hosts[name].tasks and name not in hosts.down:
            task = self.dice.choice(list(hosts[name].tasks))
            del hosts[name].tasks[task]
            hosts.world.ends(task, name)


def soak_simulated_hosts(
    cycles: int, quiet: int = QUIET, warm_at: float = WARM_AT, seed: int = 1
) -> tuple[ResourceReading, ResourceReading, dict[str, int]]:
    """Return the readings after a share ``warm_at`` of the cycles and at the end, and the counts of events;
    every task must run in the end, and none twice.
    """
    with open_memory_directory() as state:
        inventory = an_inventory(*map(an_edge, EDGES), a_robot("robot1"))
        site = WatchSite(state, tasks=build_tasks(), inventory=inventory)
        trouble, warm = FleetTrouble(site, cycles, quiet, seed), None
        counts = {"moves": 0, "starts": 0, "failed": 0, "errors": 0}
        for cycle in site.watch(cycles):
            for action in cycle.results.actions if cycle.results is not None else ():
                counts["moves"] += action.action is Action.MOVE and action.outcome is Outcome.DONE
                counts["starts"] += action.action is Action.START and action.outcome is Outcome.DONE
                counts["failed"] += action.outcome is Outcome.FAILED
            counts["errors"] += bool(cycle.error)
            trouble.strike(cycle.number)
            if cycle.number == int(cycles * warm_at):
                warm = take_reading()
            if cycle.number == cycles:
                assert warm is not None
                end = take_reading_at_rest(warm)
        counts["losses"] = trouble.losses
        assert site.hosts.placed.keys() == build_tasks().tasks.keys(), site.hosts.placed
        assert not site.hosts.world.overlap, f"ran twice: {site.hosts.world.overlap}"
        assert warm is not None
        return warm, end, counts


def time_simulated_soak(cycles: int) -> tuple[float, ResourceReading, ResourceReading, dict[str, int]]:
    """Run the soak test and return its duration in seconds, too."""
    began = time.monotonic()
    warm, end, counts = soak_simulated_hosts(cycles)
    return time.monotonic() - began, warm, end, counts
