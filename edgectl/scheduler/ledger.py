# SPDX-License-Identifier: Apache-2.0
"""Ledger of expected load (gamma): as measured, then kept up to date with every placement of the plan."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING

from edgectl.model.assignment import ExpectedLoad
from edgectl.model.demand import ZERO, Quantity
from edgectl.model.policy import Weights
from edgectl.model.resource import CPU, HOST_RESOURCES, NETWORK, NOTHING, Usage
from edgectl.model.snapshot import HostSample, LinkSample, TaskSample
from edgectl.model.task import Task
from edgectl.scheduler.capacities import Capacities, list_measured_usages, list_shown_links
from edgectl.scheduler.demand import demand_at
from edgectl.scheduler.task_usage import TaskUsage, take_greater

if TYPE_CHECKING:  # NumPy is imported only where it pays
    from edgectl.scheduler.array_scan import FreeArrays

# Free share of a place without capacity: so far below any demand that nothing ever fits.
NO_FREE_SHARE = -1e300


@dataclass(slots=True, kw_only=True)
class Ledger:
    """gamma: ``used`` by resource and place, ``links`` (bytes/s) by robot and edge.

    ``free`` and ``free_links`` hold (Delta - gamma) / Delta of the same, kept in step; so does ``weighted``,
    the sum of weight x free share over the resources of each place, once ``weigh_free`` has named weights, of
    which ``weighed`` are those that are not 0.
    ``least`` and ``least_links``: bounds below the free shares of all edges, of what `bound_free` and
    `bound_free_link` have been asked for. ``tasks`` counts those that make gamma, by place. ``mirror`` holds
    the free shares as arrays, for fleets of very many pairs (ADR 0076); a copy has none.
    """

    fleet: Capacities
    used: dict[str, list[float]]
    links: dict[str, list[float]]
    free: dict[str, list[float]]
    free_links: dict[str, list[float]]
    tasks: list[int]
    weights: Weights | None = None
    weighed: tuple[tuple[str, float], ...] = ()
    weighted: list[float] = field(default_factory=list)
    least: dict[str, float] = field(default_factory=dict)
    least_links: dict[str, float] = field(default_factory=dict)
    mirror: "FreeArrays | None" = None

    def copy(self) -> "Ledger":
        """An independent ledger with the same numbers."""
        return Ledger(
            fleet=self.fleet,
            used={name: row.copy() for name, row in self.used.items()},
            links={robot: row.copy() for robot, row in self.links.items()},
            free={name: row.copy() for name, row in self.free.items()},
            free_links={robot: row.copy() for robot, row in self.free_links.items()},
            tasks=self.tasks.copy(),
        )

    def charge(self, place: int, use: TaskUsage) -> None:
        """Add a task's load: gamma += rho for every resource."""
        self.tasks[place] += 1
        for name, amount in use.used.items():
            if amount:  # most resources are demanded by few tasks
                self._set(place, name, self.used[name][place] + amount)
        self._weigh(place)
        for robot, rate in use.links.items():
            self._set_link(place, robot, self.links[robot][place] + rate)

    def release(self, place: int, use: TaskUsage) -> None:
        """Take a task's load out of gamma, never below 0."""
        self.tasks[place] = max(0, self.tasks[place] - 1)
        for name, amount in use.used.items():
            if amount:
                self._set(place, name, max(0.0, self.used[name][place] - amount))
        self._weigh(place)
        for robot, rate in use.links.items():
            self._set_link(place, robot, max(0.0, self.links[robot][place] - rate))

    def expected(self, used: Collection[int]) -> dict[str, ExpectedLoad]:
        """Gamma of every measured host that can run tasks, and of the places ``used``, in natural order of
        names.
        """
        fleet = self.fleet
        hosts = {
            place for place, host in enumerate(fleet.places) if place < fleet.edges or host.onboard
        } | set(used)
        places = (place for place in hosts if fleet.usable[CPU.name][place] > 0)
        rates = self._list_link_rates() or [{}] * fleet.edges
        return {
            fleet.places[place].name: self._load(place, rates[place] if place < fleet.edges else {})
            for place in sorted(places, key=fleet.order.__getitem__)
        }

    def weigh_free(self, weights: Weights) -> list[float]:
        """Sum of weight x free share over the resources of hosts, by place."""
        if self.weights is not weights:
            self.weights = weights
            self.weighed = tuple((name, weights[name]) for name in self.free if weights[name])
            self.weighted = [0.0] * len(self.fleet.places)
            for place in range(len(self.fleet.places)):
                self._weigh(place)
        return self.weighted

    def bound_free(self, name: str) -> float:
        """No edge has less free of resource ``name``: what had the least may have more by now."""
        if name not in self.least:
            self.least[name] = min(self.free[name][: self.fleet.edges], default=0.0)
        return self.least[name]

    def bound_free_link(self, robot: str) -> float:
        """No link to ``robot`` has less free."""
        if robot not in self.least_links:
            self.least_links[robot] = min(self.free_links[robot], default=0.0)
        return self.least_links[robot]

    def _weigh(self, place: int) -> None:
        if self.weights is not None:
            total = 0.0
            for name, weight in self.weighed:
                total += weight * self.free[name][place]
            self.weighted[place] = total
            if self.mirror is not None:
                self.mirror.set_weighted(place, total)

    def _load(self, place: int, rates: Mapping[str, float]) -> ExpectedLoad:
        return ExpectedLoad(used=Usage({name: row[place] for name, row in self.used.items()}), links=rates)

    def _list_link_rates(self) -> list[dict[str, float]]:
        """Gamma of the links of each edge, by robot."""
        fleet = self.fleet
        robots, capacities = [*self.links], zip(*(fleet.links[robot] for robot in self.links), strict=True)
        rates = [dict(zip(robots, column, strict=True)) for column in zip(*self.links.values(), strict=True)]
        for found, row in zip(rates, capacities, strict=True):
            if None in row:
                for robot, capacity in zip(robots, row, strict=True):
                    if capacity is None:
                        del found[robot]
        return rates

    def _set(self, place: int, name: str, amount: float) -> None:
        self.used[name][place] = amount
        share = self.free[name][place] = compute_free_share(self.fleet.usable[name][place], amount)
        if name in self.least and share < self.least[name]:
            self.least[name] = share
        if self.mirror is not None:
            self.mirror.set_free(place, name, share)

    def _set_link(self, place: int, robot: str, rate: float) -> None:
        self.links[robot][place] = rate
        share = self.free_links[robot][place] = compute_free_share(self.fleet.links[robot][place], rate)
        if robot in self.least_links and share < self.least_links[robot]:
            self.least_links[robot] = share
        if self.mirror is not None:
            self.mirror.set_link(place, robot, share)


def compute_free_share(capacity: float | None, used: float) -> float:
    """(Delta - gamma) / Delta: the utility before the demand is taken off.

    Far below 0 without capacity, 1 without a limit, or where there is nothing of the kind.
    """
    if capacity in (inf, NOTHING):
        return 1.0
    return (capacity - used) / capacity if capacity else NO_FREE_SHARE


def build_measured_ledger(fleet: Capacities) -> Ledger:
    """Gamma as the profilers saw it."""
    usages = [usage or {} for usage in list_measured_usages(fleet.samples)]
    used = {
        resource.name: [usage[resource.name].used if resource.name in usage else 0.0 for usage in usages]
        for resource in HOST_RESOURCES
    }
    shown = list_shown_links(fleet.samples[: fleet.edges])
    links = {robot: _list_measured_link_rates(shown, robot) for robot in fleet.links}
    return Ledger(
        fleet=fleet,
        used=used,
        links=links,
        free={name: _compute_free_row(fleet.usable[name], row) for name, row in used.items()},
        free_links={robot: _compute_free_row(fleet.links[robot], row) for robot, row in links.items()},
        tasks=count_tasks(fleet),
    )


def count_tasks(fleet: Capacities) -> list[int]:
    """How many tasks live at each place."""
    return [_count_living(sample) for sample in fleet.samples]


def _count_living(sample: HostSample | None) -> int:
    """The living tasks on a host, those of other fleets too."""
    if sample is None or not sample.ok:
        return 0
    own = sum(run.state.alive for run in sample.tasks.values())
    return own + sum(run.state.alive for run in sample.foreign_tasks)


def _list_measured_link_rates(shown: Sequence[Mapping[str, LinkSample]], robot: str) -> list[float]:
    links = [each.get(robot) for each in shown]
    return [0.0 if link is None else link.used_bytes_per_s for link in links]


def _compute_free_row(capacities: Sequence[float | None], used: Sequence[float]) -> list[float]:
    """`compute_free_share` of each place; where nothing is used all is free, as nearly all links are."""
    pairs = zip(capacities, used, strict=True)
    return [1.0 if not load and capacity else compute_free_share(capacity, load) for capacity, load in pairs]


def compute_demand_usage(fleet: Capacities, task: Task, place: int) -> TaskUsage:
    """Load (d) that ``task`` counts for at ``place``: its demand (rho), or what it was measured to use, if it
    runs and that is more (ADR 0060).

    A share is of the capacity before limits; a robot's own computer needs no link.
    """
    declared = compute_stated_usage(fleet, task, place)
    floor = fleet.floors.get(task.name)
    if floor is None:
        return declared
    found = take_greater(declared, floor)
    return TaskUsage(used=found.used, links=_select_present_links(fleet, found.links, place))


def compute_stated_usage(fleet: Capacities, task: Task, place: int) -> TaskUsage:
    """Demand (rho) of ``task`` at ``place``, whatever it was measured to use."""
    demand = demand_at(fleet, task, place)
    used = {}
    for name, row in fleet.raw.items():
        quantity = demand[name]
        used[name] = 0.0 if quantity is None else quantity.of(row[place])
    return TaskUsage(used=used, links=_compute_link_rates(fleet, task.robots, place, demand[NETWORK.name]))


def _select_present_links(fleet: Capacities, rates: Mapping[str, float], place: int) -> dict[str, float]:
    if place >= fleet.edges:
        return {}
    return {robot: rate for robot, rate in rates.items() if fleet.links[robot][place] is not None}


def _compute_link_rates(
    fleet: Capacities, robots: tuple[str, ...], place: int, throughput: Quantity | None
) -> dict[str, float]:
    rates: dict[str, float] = {}
    for robot in robots if place < fleet.edges else ():
        row = fleet.nominal_links.get(robot)
        capacity = None if row is None else row[place]
        if capacity is not None:
            rates[robot] = 0.0 if throughput is None else throughput.of(capacity)
    return rates


def compute_measured_usage(fleet: Capacities, sample: TaskSample, task: Task | None, place: int) -> TaskUsage:
    """Measured usage of a running task (None: no file names it).

    A rate that is not known by link is split evenly over the task's links. No host tells the share of one
    task in a declared budget: there the task is taken to use its demand.
    """
    robots = task.robots if task is not None else ()
    rates = (
        sample.links
        if sample.links is not None
        else {robot: sample.used[NETWORK.name] / len(robots) for robot in robots}
    )
    links = {robot: rate for robot, rate in rates.items() if place < fleet.edges and robot in fleet.links}
    used = {
        resource.name: _get_demand(fleet, task, place, resource.name)
        if resource.optional
        else sample.used[resource.name]
        for resource in HOST_RESOURCES
    }
    return TaskUsage(used=used, links=links)


def _get_demand(fleet: Capacities, task: Task | None, place: int, name: str) -> float:
    return 0.0 if task is None else (task.demand[name] or ZERO).of(fleet.raw[name][place])
