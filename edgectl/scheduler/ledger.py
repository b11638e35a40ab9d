"""gamma, the expected load (DESIGN 5.3): measured first, then kept up to date with every placement of the plan."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from edgectl.model.assignment import ExpectedLoad
from edgectl.model.snapshot import TaskSample
from edgectl.model.task import ZERO, Quantity, Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.demand import demand_at

# Free share of a place without capacity: so far below any demand that nothing ever fits.
NO_FREE_SHARE = -1e300


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskUsage:
    """What one task takes of one place: cores, bytes, and bytes/s by robot."""

    cpu: float = 0.0
    memory: float = 0.0
    links: Mapping[str, float] = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class Ledger:
    """gamma by place (cores, bytes) and by robot and edge (bytes/s); ``free_*`` is (Delta - gamma) / Delta of the same, kept in step."""

    fleet: Capacities
    cpu: list[float]
    memory: list[float]
    links: dict[str, list[float]]
    free_cpu: list[float]
    free_memory: list[float]
    free_links: dict[str, list[float]]

    def copy(self) -> "Ledger":
        """An independent ledger with the same numbers."""
        return Ledger(
            fleet=self.fleet,
            cpu=self.cpu.copy(),
            memory=self.memory.copy(),
            links={robot: row.copy() for robot, row in self.links.items()},
            free_cpu=self.free_cpu.copy(),
            free_memory=self.free_memory.copy(),
            free_links={robot: row.copy() for robot, row in self.free_links.items()},
        )

    def charge(self, place: int, use: TaskUsage) -> None:
        """Gamma += rho, all three."""
        self._set(place, self.cpu[place] + use.cpu, self.memory[place] + use.memory)
        for robot, rate in use.links.items():
            self._set_link(place, robot, self.links[robot][place] + rate)

    def release(self, place: int, use: TaskUsage) -> None:
        """A task's own use leaves gamma, never below 0."""
        self._set(place, max(0.0, self.cpu[place] - use.cpu), max(0.0, self.memory[place] - use.memory))
        for robot, rate in use.links.items():
            self._set_link(place, robot, max(0.0, self.links[robot][place] - rate))

    def expected(self, used: Collection[int]) -> dict[str, ExpectedLoad]:
        """Gamma of every measured host that can run tasks, and of the places ``used``, in natural order of names."""
        fleet = self.fleet
        hosts = {
            place for place, host in enumerate(fleet.places) if place < fleet.edges or host.onboard
        } | set(used)
        places = (place for place in hosts if fleet.cpu[place] > 0)
        return {
            fleet.places[place].name: self._load(place)
            for place in sorted(places, key=fleet.order.__getitem__)
        }

    def _load(self, place: int) -> ExpectedLoad:
        linked = place < self.fleet.edges
        links = {
            robot: row[place]
            for robot, row in self.links.items()
            if linked and self.fleet.links[robot][place] is not None
        }
        return ExpectedLoad(used_cores=self.cpu[place], used_bytes=self.memory[place], links=links)

    def _set(self, place: int, cpu: float, memory: float) -> None:
        self.cpu[place], self.memory[place] = cpu, memory
        self.free_cpu[place] = compute_free_share(self.fleet.cpu[place], cpu)
        self.free_memory[place] = compute_free_share(self.fleet.memory[place], memory)

    def _set_link(self, place: int, robot: str, rate: float) -> None:
        self.links[robot][place] = rate
        self.free_links[robot][place] = compute_free_share(self.fleet.links[robot][place], rate)


def compute_free_share(capacity: float | None, used: float) -> float:
    """(Delta - gamma) / Delta: the utility before the demand is taken off; far below 0 without capacity."""
    return (capacity - used) / capacity if capacity else NO_FREE_SHARE


def build_measured_ledger(fleet: Capacities) -> Ledger:
    """Gamma as the profilers saw it."""
    cpu = [sample.cpu.used_cores if sample and sample.ok and sample.cpu else 0.0 for sample in fleet.samples]
    memory = [
        sample.memory.used_bytes if sample and sample.ok and sample.memory else 0.0
        for sample in fleet.samples
    ]
    links = {
        robot: [_get_measured_link_rate(fleet, edge, robot) for edge in range(fleet.edges)]
        for robot in fleet.links
    }
    return Ledger(
        fleet=fleet,
        cpu=cpu,
        memory=memory,
        links=links,
        free_cpu=[compute_free_share(*pair) for pair in zip(fleet.cpu, cpu, strict=True)],
        free_memory=[compute_free_share(*pair) for pair in zip(fleet.memory, memory, strict=True)],
        free_links={
            robot: [compute_free_share(*pair) for pair in zip(fleet.links[robot], row, strict=True)]
            for robot, row in links.items()
        },
    )


def _get_measured_link_rate(fleet: Capacities, edge: int, robot: str) -> float:
    sample = fleet.samples[edge]
    link = sample.links.get(robot) if sample else None
    return link.used_bytes_per_s if link else 0.0


def compute_demand_usage(fleet: Capacities, task: Task, place: int) -> TaskUsage:
    """Rho of ``task`` at ``place``. A share is of the capacity before limits; a robot's own computer needs no link."""
    wanted = demand_at(fleet, task, place)
    return TaskUsage(
        cpu=(wanted.cpu or ZERO).of(fleet.raw_cpu[place]),
        memory=(wanted.memory or ZERO).of(fleet.raw_memory[place]),
        links=_compute_link_rates(fleet, task.robots, place, wanted.throughput or ZERO),
    )


def _compute_link_rates(
    fleet: Capacities, robots: tuple[str, ...], place: int, throughput: Quantity
) -> dict[str, float]:
    if place >= fleet.edges:
        return {}
    capacities = ((robot, fleet.links[robot][place]) for robot in robots if robot in fleet.links)
    return {robot: throughput.of(capacity) for robot, capacity in capacities if capacity is not None}


def compute_measured_usage(
    fleet: Capacities, sample: TaskSample, robots: tuple[str, ...], place: int
) -> TaskUsage:
    """What a running task was seen to use; a rate that is not known by link is split evenly over the task's links."""
    rates = (
        sample.links
        if sample.links is not None
        else {robot: sample.used_bytes_per_s / len(robots) for robot in robots}
    )
    links = {robot: rate for robot, rate in rates.items() if place < fleet.edges and robot in fleet.links}
    return TaskUsage(cpu=sample.used_cores, memory=sample.used_bytes, links=links)
