"""Eq. (4) for one task at every edge at once: the tight loop. Its reference is ``feasibility.read``; tests compare the two.

A row holds one number per edge. The scan works on shares: UT = free share - demanded share.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from edgectl.model.policy import Weights
from edgectl.model.task import ZERO, Demand, Quantity, Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.demand import demand_at
from edgectl.scheduler.ledger import NO_FREE_SHARE, Ledger
from edgectl.scheduler.utility import EPSILON

Row = Sequence[float]
# Taken off the total of a place where the task does not fit, so that one row says both.
INFEASIBLE_PENALTY = 1e6
EXCLUDED_TOTAL = float("-inf")


def is_feasible_total(total: float) -> bool:
    """Whether a scanned total is that of a feasible place (which is never below -1)."""
    return total > -INFEASIBLE_PENALTY / 2


@dataclass(slots=True, kw_only=True)
class DemandShares:
    """Demands as shares of capacity, filled as they are first asked for: by quantity, of which a fleet has few; by the task's name
    where history decides, for there the demand may differ from edge to edge.
    """

    fleet: Capacities
    zeros: list[float]
    ones: list[float]
    cpu: dict[Quantity | str, list[float]] = field(default_factory=dict)
    memory: dict[Quantity | str, list[float]] = field(default_factory=dict)
    inverse_links: dict[str, list[float]] = field(default_factory=dict)
    links: dict[tuple[str, str], list[float]] = field(default_factory=dict)

    def of_cpu(self, task: Task) -> list[float]:
        """rho_cpu / Delta_cpu at every edge."""
        fleet = self.fleet
        if task.name not in fleet.demands:
            return _get_cached_row(self.cpu, task.demand.cpu or ZERO, fleet.raw_cpu, fleet.cpu, fleet.edges)
        if task.name not in self.cpu:
            self.cpu[task.name] = _build_share_row(
                [wanted.cpu for wanted in self._demands(task)], fleet.raw_cpu, fleet.cpu
            )
        return self.cpu[task.name]

    def of_memory(self, task: Task) -> list[float]:
        """rho_mem / Delta_mem at every edge."""
        fleet = self.fleet
        if task.name not in fleet.demands:
            return _get_cached_row(
                self.memory, task.demand.memory or ZERO, fleet.raw_memory, fleet.memory, fleet.edges
            )
        if task.name not in self.memory:
            self.memory[task.name] = _build_share_row(
                [wanted.memory for wanted in self._demands(task)], fleet.raw_memory, fleet.memory
            )
        return self.memory[task.name]

    def of_link(self, task: Task, robot: str) -> list[float]:
        """rho_thp / Delta_thp of every edge's link to ``robot``, of a task whose history decides."""
        key = task.name, robot
        if key not in self.links:
            capacities = [capacity or 0.0 for capacity in self.fleet.links[robot]]
            self.links[key] = _build_share_row(
                [wanted.throughput for wanted in self._demands(task)], capacities, capacities
            )
        return self.links[key]

    def _demands(self, task: Task) -> list[Demand]:
        return [demand_at(self.fleet, task, edge) for edge in range(self.fleet.edges)]

    def per_byte(self, robot: str) -> list[float]:
        """1 / Delta_thp of every edge's link to ``robot``; 0 where there is none."""
        if robot not in self.inverse_links:
            self.inverse_links[robot] = [
                1.0 / capacity if capacity else 0.0 for capacity in self.fleet.links[robot]
            ]
        return self.inverse_links[robot]


def build_demand_shares(fleet: Capacities) -> DemandShares:
    """Empty shares of ``fleet``."""
    return DemandShares(fleet=fleet, zeros=[0.0] * fleet.edges, ones=[1.0] * fleet.edges)


def _get_cached_row(
    cache: dict[Quantity | str, list[float]], quantity: Quantity, raw: Row, usable: Row, edges: int
) -> list[float]:
    if quantity not in cache:
        cache[quantity] = _build_share_row([quantity] * edges, raw, usable)
    return cache[quantity]


def _build_share_row(quantities: Sequence[Quantity | None], raw: Row, usable: Row) -> list[float]:
    """Each edge's quantity as a share of what is usable there; ``raw`` is the capacity that percentages are of."""
    found = zip(quantities, raw, usable, strict=False)  # the capacities go on to the robots
    return [
        (quantity or ZERO).of(whole) / capacity if capacity > 0 else 0.0
        for quantity, whole, capacity in found
    ]


def compute_network_rows(ledger: Ledger, shares: DemandShares, task: Task) -> tuple[Row, Row, float]:
    """Free share of the worst link at every edge, and the demanded share as a row and the factor that it is multiplied by.

    Without a robot 1 is free and nothing is demanded.
    """
    if not task.robots:
        return shares.ones, shares.zeros, 0.0
    if any(robot not in ledger.free_links for robot in task.robots):
        return [NO_FREE_SHARE] * ledger.fleet.edges, shares.zeros, 0.0
    units, value = _get_demanded_link_shares(shares, task)
    rows = [(ledger.free_links[robot], unit) for robot, unit in zip(task.robots, units, strict=True)]
    if len(rows) == 1:
        return *rows[0], value
    left = [[free - value * unit for free, unit in zip(*row, strict=True)] for row in rows]
    return [min(column) for column in zip(*left, strict=True)], shares.zeros, 0.0


def _get_demanded_link_shares(shares: DemandShares, task: Task) -> tuple[list[list[float]], float]:
    """The demanded share of the link to each robot: a row, and the factor that all rows are multiplied by."""
    if task.name in shares.fleet.demands:
        return [shares.of_link(task, robot) for robot in task.robots], 1.0
    quantity = task.demand.throughput or ZERO
    return [
        shares.ones if quantity.relative else shares.per_byte(robot) for robot in task.robots
    ], quantity.value


def compute_resource_totals(
    ledger: Ledger, shares: DemandShares, task: Task, weights: Weights, *, offset: float
) -> list[float]:
    """``offset`` plus the resource part of the total at every edge, less ``PENALTY`` where the task does not fit."""
    free_network, units, factor = compute_network_rows(ledger, shares, task)
    w_cpu, w_memory, w_network = weights.cpu, weights.memory, weights.network
    lowest = -EPSILON
    row: list[float] = []
    append = row.append
    rows = zip(
        ledger.free_cpu, shares.of_cpu(task),
        ledger.free_memory, shares.of_memory(task),
        free_network, units,
        strict=False,  # the free rows go on to the robots
    )  # fmt: skip
    for free_c, need_c, free_m, need_m, free_n, unit in rows:
        cpu = free_c - need_c
        memory = free_m - need_m
        link = free_n - factor * unit
        total = w_cpu * cpu + w_memory * memory + w_network * link + offset
        append(total if cpu >= lowest and memory >= lowest and link >= lowest else total - INFEASIBLE_PENALTY)
    return row


def compute_worst_terms(ledger: Ledger, shares: DemandShares, task: Task) -> list[float]:
    """The least of UT_cpu, UT_mem, UT_net at every edge: how far the task is from fitting."""
    free_network, units, factor = compute_network_rows(ledger, shares, task)
    need_cpu, need_memory = shares.of_cpu(task), shares.of_memory(task)
    return [
        min(
            ledger.free_cpu[edge] - need_cpu[edge],
            ledger.free_memory[edge] - need_memory[edge],
            free_network[edge] - factor * units[edge],
        )
        for edge in range(ledger.fleet.edges)
    ]
