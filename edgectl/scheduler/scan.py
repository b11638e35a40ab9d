"""Eq.

(4) for one task at every edge at once: the tight loop. Its reference is ``feasibility``; tests compare the
two. A row holds one number per edge. The scan works on shares: UT = free share - demanded share, one row
operation per resource.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import sub

from edgectl.model.policy import Weights
from edgectl.model.resource import HOST_RESOURCES, NETWORK, RESOURCES
from edgectl.model.task import ZERO, Quantity, Task
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
    """Demands as shares of capacity, filled as they are first asked for.

    ``rows`` is keyed by resource and quantity, of which a fleet has few; by the task's name where history
    decides, for there the demand may differ from edge to edge. ``links`` and ``inverse_links`` are of the
    links to one robot.
    """

    fleet: Capacities
    ones: list[float]
    rows: dict[tuple[str, Quantity | str], list[float]] = field(default_factory=dict)
    inverse_links: dict[str, list[float]] = field(default_factory=dict)
    links: dict[tuple[str, Quantity | str], list[float]] = field(default_factory=dict)

    def of_host(self, task: Task, resource: str) -> list[float]:
        """Rho / Delta of a resource of hosts at every edge."""
        quantity = task.demand[resource] or ZERO
        measured = task.name in self.fleet.demands
        key = resource, task.name if measured else quantity
        row = self.rows.get(key)
        if row is None:
            quantities = self._list_quantities(task, resource) if measured else [quantity] * self.fleet.edges
            row = _build_share_row(quantities, self.fleet.raw[resource], self.fleet.usable[resource])
            self.rows[key] = row
        return row

    def of_link(self, task: Task, robot: str) -> list[float]:
        """Rho / Delta of every edge's link to ``robot``."""
        quantity = task.demand[NETWORK.name] or ZERO
        measured = task.name in self.fleet.demands
        key = robot, task.name if measured else quantity
        row = self.links.get(key)
        if row is None:
            row = (
                self._build_measured_link_row(task, robot)
                if measured
                else self._build_link_row(quantity, robot)
            )
            self.links[key] = row
        return row

    def _build_measured_link_row(self, task: Task, robot: str) -> list[float]:
        capacities = [capacity or 0.0 for capacity in self.fleet.links[robot]]
        return _build_share_row(self._list_quantities(task, NETWORK.name), capacities, capacities)

    def _build_link_row(self, quantity: Quantity, robot: str) -> list[float]:
        units = self.ones if quantity.relative else self._per_byte(robot)
        return [quantity.value * unit for unit in units]

    def _list_quantities(self, task: Task, resource: str) -> list[Quantity | None]:
        return [demand_at(self.fleet, task, edge)[resource] for edge in range(self.fleet.edges)]

    def _per_byte(self, robot: str) -> list[float]:
        """1 / Delta of every edge's link to ``robot``; 0 where there is none."""
        if robot not in self.inverse_links:
            self.inverse_links[robot] = [
                1.0 / capacity if capacity else 0.0 for capacity in self.fleet.links[robot]
            ]
        return self.inverse_links[robot]


def build_demand_shares(fleet: Capacities) -> DemandShares:
    """Empty shares of ``fleet``."""
    return DemandShares(fleet=fleet, ones=[1.0] * fleet.edges)


def _build_share_row(quantities: Sequence[Quantity | None], raw: Row, usable: Row) -> list[float]:
    """Each edge's quantity as a share of what is usable there.

    ``raw`` is the capacity that percentages are of.
    """
    found = zip(quantities, raw, usable, strict=False)  # the capacities go on to the robots
    return [
        (quantity or ZERO).of(whole) / capacity if capacity > 0 else 0.0
        for quantity, whole, capacity in found
    ]


def _compute_network_terms(ledger: Ledger, shares: DemandShares, task: Task) -> Row:
    """UT of the worst link at every edge; 1 without a robot."""
    if not task.robots:
        return shares.ones
    if any(robot not in ledger.free_links for robot in task.robots):
        return [NO_FREE_SHARE] * ledger.fleet.edges
    rows = [list(map(sub, ledger.free_links[robot], shares.of_link(task, robot))) for robot in task.robots]
    return rows[0] if len(rows) == 1 else [min(column) for column in zip(*rows, strict=True)]


def _compute_term_rows(ledger: Ledger, shares: DemandShares, task: Task) -> dict[str, Row]:
    """UT of each resource at every edge."""
    terms: dict[str, Row] = {
        # The free rows go on to the robots; map stops with the edges.
        resource.name: list(map(sub, ledger.free[resource.name], shares.of_host(task, resource.name)))
        for resource in HOST_RESOURCES
    }
    terms[NETWORK.name] = _compute_network_terms(ledger, shares, task)
    return terms


def compute_resource_totals(
    ledger: Ledger, shares: DemandShares, task: Task, weights: Weights, *, offset: float
) -> list[float]:
    """``offset`` plus the resource part of the total at every edge, less the penalty where the task does not
    fit.
    """
    terms = _compute_term_rows(ledger, shares, task)
    first, *others, last = ((weights[resource.name], terms[resource.name]) for resource in RESOURCES)
    weight, row = first
    totals = [weight * term for term in row]
    for weight, row in others:
        totals = [total + weight * term for total, term in zip(totals, row, strict=True)]
    weight, row = last
    totals = [total + weight * term + offset for total, term in zip(totals, row, strict=True)]
    for edge in _find_infeasible_edges(terms):
        totals[edge] -= INFEASIBLE_PENALTY
    return totals


def _find_infeasible_edges(terms: dict[str, Row]) -> set[int]:
    """Edges that lack some resource. The least of a row tells in C whether there are any."""
    return {
        edge
        for row in terms.values()
        if min(row, default=0.0) < -EPSILON
        for edge, term in enumerate(row)
        if term < -EPSILON
    }


def compute_worst_terms(ledger: Ledger, shares: DemandShares, task: Task) -> list[float]:
    """The least UT of the resources at every edge: how far the task is from fitting."""
    return list(map(min, *_compute_term_rows(ledger, shares, task).values()))
