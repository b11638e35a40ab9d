"""The real loop over simulated hosts that die, return, lose tasks and refuse actions, on a clock that jumps."""

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
from tests.soak.gauge import Reading, at_rest, take
from tests.usecases.watching import Site

EDGES = ("edge1", "edge2", "edge3")
# Cycles at the end in which everything is mended: longer than a task that failed rests, or a share of a short run without failures.
QUIET = 150
# Share of the cycles after which it is warm: memory is highest while the journal is read, which is put away at 1 MiB, after some 4,800 cycles.
WARM_AT = 0.6


def work() -> Tasks:
    return some_tasks(
        a_task("slam", cpu=1.0, robots=["robot1"]),
        a_task("navigation", cpu=0.3, robots=["robot1"], needs=["slam"]),
        a_task("detection", cpu=1.5, memory=2**20, robots=["robot1"]),
        a_task("merge", cpu=0.2),
    )


@contextmanager
def directory() -> Iterator[Path]:
    """A place for the state in memory, where there is one: what is measured is the loop, not the disk."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        yield Path(name)


class Trouble:
    """What happens to the fleet, drawn from a seed. Everything is mended by the last ``quiet`` cycles."""

    def __init__(self, site: Site, cycles: int, quiet: int, seed: int) -> None:
        self.site, self.dice, self.last = site, random.Random(seed), cycles - quiet
        self.back: dict[str, int] = {}
        self.losses = 0

    def strike(self, number: int) -> None:
        """Between cycle ``number`` and the next."""
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


def soak(
    cycles: int, quiet: int = QUIET, warm_at: float = WARM_AT, seed: int = 1
) -> tuple[Reading, Reading, dict[str, int]]:
    """Readings after a share ``warm_at`` of the cycles and at the end, and what happened; in the end every task runs, and none ran twice."""
    with directory() as state:
        inventory = an_inventory(*map(an_edge, EDGES), a_robot("robot1"))
        site = Site(state, tasks=work(), inventory=inventory)
        trouble, warm = Trouble(site, cycles, quiet, seed), None
        counts = {"moves": 0, "starts": 0, "failed": 0, "errors": 0}
        for cycle in site.watch(cycles):
            for action in cycle.results.actions if cycle.results is not None else ():
                counts["moves"] += action.action is Action.MOVE and action.outcome is Outcome.DONE
                counts["starts"] += action.action is Action.START and action.outcome is Outcome.DONE
                counts["failed"] += action.outcome is Outcome.FAILED
            counts["errors"] += bool(cycle.error)
            trouble.strike(cycle.number)
            if cycle.number == int(cycles * warm_at):
                warm = take()
            if cycle.number == cycles:
                assert warm is not None
                end = at_rest(warm)
        counts["losses"] = trouble.losses
        assert site.hosts.placed.keys() == work().tasks.keys(), site.hosts.placed
        assert not site.hosts.world.overlap, f"ran twice: {site.hosts.world.overlap}"
        assert warm is not None
        return warm, end, counts


def timed(cycles: int) -> tuple[float, Reading, Reading, dict[str, int]]:
    """The same with the seconds that it took."""
    began = time.monotonic()
    warm, end, counts = soak(cycles)
    return time.monotonic() - began, warm, end, counts
