# SPDX-License-Identifier: Apache-2.0
"""Equation (4) for one task at every edge at once: the tight loop.

Its reference is ``feasibility``; tests compare the two. A row holds one number per edge. The scan works on
shares: UT = free share - demanded share, one row operation per resource.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import lt, sub
from typing import Any, NamedTuple

from edgectl.model.demand import ZERO, Quantity
from edgectl.model.policy import Weights
from edgectl.model.resource import HOST_RESOURCES, NETWORK
from edgectl.model.task import Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.demand import demand_at
from edgectl.scheduler.edge_groups import EdgeGroups, group_edges
from edgectl.scheduler.ledger import NO_FREE_SHARE, Ledger
from edgectl.scheduler.utility import EPSILON

Row = Sequence[float]
# Taken off the total of a place where the task does not fit, so that one row says both.
INFEASIBLE_PENALTY = 1e6
EXCLUDED_TOTAL = float("-inf")
# Shares that one cache of `DemandShares` holds: some 20 MiB.
MAX_CACHED_SHARES = 500_000
_HOST_NAMES = tuple(resource.name for resource in HOST_RESOURCES)


class ListTotals(list[float]):
    """Eq. (4) by place. ``array_scan.ArrayTotals`` is the same on an array."""

    __slots__ = ()

    def find_top(self) -> int | None:
        """The first feasible place with the greatest total."""
        top = max(self, default=EXCLUDED_TOTAL)
        return self.index(top) if is_feasible_total(top) else None

    def list_at_least(self, level: float, first: int) -> list[int]:
        """The places whose total is ``level`` or more, in order. ``first``: the first of the greatest, which
        is one of them.
        """
        others = max(self[:first], default=EXCLUDED_TOTAL), max(self[first + 1 :], default=EXCLUDED_TOTAL)
        if max(others) < level:
            return [first]  # the common case: a scan in C instead of one in Python
        return [place for place, total in enumerate(self) if total >= level]

    def exclude(self, places: Collection[int]) -> None:
        """Take ``places`` out."""
        for place in places:
            self[place] = EXCLUDED_TOTAL

    def copy(self) -> "ListTotals":
        """An independent row with the same totals."""
        return ListTotals(self)


def is_feasible_total(total: float) -> bool:
    """Whether a scanned total is that of a feasible place (which is never below -1)."""
    return total > -INFEASIBLE_PENALTY / 2


class ShareRow(NamedTuple):
    """A demand as a share of capacity by edge, and the greatest of these shares."""

    shares: Row
    greatest: float


@dataclass(slots=True, kw_only=True)
class DemandShares:
    """Demands as shares of capacity, filled as they are first asked for.

    Rho is what is stated or learned from history; d is at least what a running task was measured to use (ADR
    0060). ``rows`` is keyed by resource and quantity, of which a fleet has few, ``weighted`` by all of a
    task's quantities; ``links`` and ``inverse_links`` are of the links to one robot. All but the last forget
    what they hold when they are full (`MAX_CACHED_SHARES`). With a history of its own every task has other
    quantities: its rows are not kept, but computed by group of edges that are alike (ADR 0101): ``groups`` of
    hosts, ``link_groups`` of links to one robot.
    """

    fleet: Capacities
    ones: list[float]
    zeros: list[float]
    rows: dict[object, ShareRow] = field(default_factory=dict)
    weighted: dict[object, Row] = field(default_factory=dict)
    inverse_links: dict[str, list[float]] = field(default_factory=dict)
    links: dict[object, ShareRow] = field(default_factory=dict)
    groups: EdgeGroups | None = None
    link_groups: dict[str, EdgeGroups] = field(default_factory=dict)

    def of_host(self, task: Task, resource: str) -> Row:
        """D / Delta of a resource of hosts at every edge."""
        return self.find_host_row(task, resource).shares

    def find_host_row(self, task: Task, resource: str) -> ShareRow:
        """`of_host`, and its greatest."""
        found = self._get_stated_row(task, resource)
        floor = self.fleet.floors.get(task.name)
        if floor is None or resource not in floor.used:
            return found
        return _rate_row(_raise_shares(found.shares, floor.used[resource], self.fleet.usable[resource]))

    def _get_stated_row(self, task: Task, resource: str) -> ShareRow:
        """Rho / Delta of a resource of hosts at every edge."""
        if task.name in self.fleet.demands:
            groups = self._group_hosts()
            shares = self._list_measured_shares(task, resource, groups)
            return ShareRow(groups.expand(shares), max(shares, default=0.0))
        quantity = task.demand[resource] or ZERO
        key = resource, quantity.value, quantity.relative
        row = self.rows.get(key)
        if row is None:
            raw = self.fleet.raw[resource]
            amounts = [quantity.of(capacity) for capacity in raw[: self.fleet.edges]]
            row = _rate_row(_build_share_row(amounts, self.fleet.usable[resource]))
            self._keep(self.rows, key, row)
        return row

    def _group_hosts(self) -> EdgeGroups:
        fleet = self.fleet
        if self.groups is None:
            rows = (each[name] for each in (fleet.raw, fleet.usable) for name in fleet.counted)
            columns = fleet.classes, *rows
            self.groups = group_edges(columns, fleet.edges)
        return self.groups

    def _list_measured_shares(self, task: Task, resource: str, groups: EdgeGroups) -> list[float]:
        """Rho / Delta of a resource of hosts at the first edge of each group."""
        fleet = self.fleet
        raw, usable = fleet.raw[resource], fleet.usable[resource]
        return [
            _divide((demand_at(fleet, task, edge)[resource] or ZERO).of(raw[edge]), usable[edge])
            for edge in groups.first
        ]

    def _keep(self, cache: dict[object, Any], key: object, row: Row | ShareRow) -> None:
        if len(cache) * self.fleet.edges > MAX_CACHED_SHARES:
            cache.clear()
        cache[key] = row

    def of_weighted(self, task: Task, weights: Weights) -> Row:
        """Sum of weight x (d / Delta) over the resources of hosts at every edge, under one policy."""
        if task.name in self.fleet.floors:
            return self._add_weighted(task, weights)
        if task.name in self.fleet.demands:
            groups = self._group_hosts()
            shares = {
                name: self._list_measured_shares(task, name, groups) for name in _HOST_NAMES if weights[name]
            }
            return groups.expand(_add_weighted(shares, weights, len(groups.first)))
        key = tuple([task.demand[name] for name in _HOST_NAMES])
        row = self.weighted.get(key)
        if row is None:
            row = self._add_weighted(task, weights)
            self._keep(self.weighted, key, row)
        return row

    def _add_weighted(self, task: Task, weights: Weights) -> Row:
        rows = {name: self.of_host(task, name) for name in _HOST_NAMES if weights[name]}
        return _add_weighted(rows, weights, self.fleet.edges)

    def of_link(self, task: Task, robot: str) -> Row:
        """D / Delta of every edge's link to ``robot``."""
        return self.find_link_row(task, robot).shares

    def find_link_row(self, task: Task, robot: str) -> ShareRow:
        """`of_link`, and its greatest."""
        found = self._get_stated_link_row(task, robot)
        floor = self.fleet.floors.get(task.name)
        if floor is None or robot not in floor.links:
            return found
        return _rate_row(_raise_shares(found.shares, floor.links[robot], self.fleet.links[robot]))

    def _get_stated_link_row(self, task: Task, robot: str) -> ShareRow:
        """Rho / Delta of every edge's link to ``robot``."""
        if task.name in self.fleet.demands:
            return self._build_measured_link_row(task, robot)
        quantity = task.demand[NETWORK.name] or ZERO
        key = robot, quantity.value, quantity.relative
        row = self.links.get(key)
        if row is None:
            row = _rate_row(self._build_link_row(quantity, robot))
            self._keep(self.links, key, row)
        return row

    def _build_measured_link_row(self, task: Task, robot: str) -> ShareRow:
        fleet, nominal, now = self.fleet, self.fleet.nominal_links[robot], self.fleet.links[robot]
        groups = self.link_groups.get(robot)
        if groups is None:
            groups = self.link_groups[robot] = group_edges((fleet.classes, nominal, now), fleet.edges)
        shares = [
            _divide((demand_at(fleet, task, edge)[NETWORK.name] or ZERO).of(nominal[edge] or 0.0), now[edge])
            for edge in groups.first
        ]
        return ShareRow(groups.expand(shares), max(shares, default=0.0))

    def _build_link_row(self, quantity: Quantity, robot: str) -> list[float]:
        units = self._per_nominal(robot) if quantity.relative else self._per_byte(robot)
        return [quantity.value * unit for unit in units]

    def _per_nominal(self, robot: str) -> list[float]:
        """The nominal capacity of every edge's link to ``robot`` as a share of what it carries now."""
        if self.fleet.nominal_links[robot] == self.fleet.links[robot]:
            return self.ones
        pairs = zip(self.fleet.nominal_links[robot], self._per_byte(robot), strict=True)
        return [(nominal or 0.0) * unit for nominal, unit in pairs]

    def _per_byte(self, robot: str) -> list[float]:
        """1 / Delta of every edge's link to ``robot``; 0 where there is none."""
        if robot not in self.inverse_links:
            self.inverse_links[robot] = [
                1.0 / capacity if capacity else 0.0 for capacity in self.fleet.links[robot]
            ]
        return self.inverse_links[robot]


def _rate_row(shares: Row) -> ShareRow:
    return ShareRow(shares, max(shares, default=0.0))


def build_demand_shares(fleet: Capacities, former: DemandShares | None = None) -> DemandShares:
    """Shares of ``fleet``: empty, or the ``former`` ones, of the same capacities: none depends on loads."""
    if former is not None:
        return replace(former, fleet=fleet)
    return DemandShares(fleet=fleet, ones=[1.0] * fleet.edges, zeros=[0.0] * fleet.edges)


def _divide(amount: float, capacity: float | None) -> float:
    """The amount as a share; 0 where there is no capacity."""
    return amount / capacity if capacity else 0.0


def _add_weighted(rows: Mapping[str, Row], weights: Weights, edges: int) -> list[float]:
    """The sum of weight x share over ``rows``, one for each resource of hosts that is weighed."""
    total = [0.0] * edges
    for name, row in rows.items():
        weight = weights[name]
        total = [so_far + weight * share for so_far, share in zip(total, row, strict=True)]
    return total


def _build_share_row(amounts: Row, usable: Row) -> list[float]:
    """Each edge's amount as a share of what is usable there."""
    found = zip(amounts, usable, strict=False)  # the capacities go on to the robots
    return [amount / capacity if capacity > 0 else 0.0 for amount, capacity in found]


def _raise_shares(row: Row, amount: float, capacities: Sequence[float | None]) -> list[float]:
    """The shares, none below that of ``amount``.

    Not kept: one row for each task that uses more than it declares would fill the memory.
    """
    found = zip(row, capacities, strict=False)  # the capacities go on to the robots
    return [max(share, amount / capacity) if capacity else 0.0 for share, capacity in found]


class ResourceRows(NamedTuple):
    """Free and demanded share of one resource by edge: UT is their difference.

    The free row of a host's resource goes on to the robots. ``fits``: it is certain that UT is nowhere below
    0; False says nothing.
    """

    free: Row
    demanded: Row
    fits: bool = False


def list_limiting_resources(fleet: Capacities, task: Task) -> Sequence[str]:
    """The resources of hosts that limit some place, and those that only ``task`` demands."""
    counted, others = fleet.counted, list_uncounted_demands(fleet, task)
    return [name for name in _HOST_NAMES if name in counted or name in others] if others else counted


def list_uncounted_demands(fleet: Capacities, task: Task) -> list[str]:
    """What the task demands of resources that limit no place, or that no host has."""
    counted = fleet.counted
    if len(counted) == len(_HOST_NAMES):
        return []
    return [
        name
        for name in _HOST_NAMES
        if name not in counted and (demand := task.demand[name]) is not None and demand.value > 0
    ]


def _find_link_rows(ledger: Ledger, shares: DemandShares, task: Task) -> ResourceRows:
    """The rows of the only link; the worst of several, with the demand taken off; 1 without a robot."""
    if not task.robots:
        return ResourceRows(shares.ones, shares.zeros, fits=True)
    if any(robot not in ledger.free_links for robot in task.robots):
        return ResourceRows([NO_FREE_SHARE] * ledger.fleet.edges, shares.zeros)
    rows = [_find_link_row(ledger, shares, task, robot) for robot in task.robots]
    if len(rows) == 1:
        return rows[0]
    return ResourceRows(
        [min(column) for column in zip(*map(_subtract_rows, rows), strict=True)], shares.zeros
    )


def _find_link_row(ledger: Ledger, shares: DemandShares, task: Task, robot: str) -> ResourceRows:
    demanded, greatest = shares.find_link_row(task, robot)
    fits = greatest <= ledger.bound_free_link(robot)
    return ResourceRows(ledger.free_links[robot], demanded, fits)


def _find_host_row(ledger: Ledger, shares: DemandShares, task: Task, name: str) -> ResourceRows:
    demanded, greatest = shares.find_host_row(task, name)
    return ResourceRows(ledger.free[name], demanded, fits=greatest <= ledger.bound_free(name))


def _subtract_rows(rows: ResourceRows) -> list[float]:
    """UT at every edge."""
    return list(map(sub, rows.free, rows.demanded))


def compute_resource_totals(
    ledger: Ledger, shares: DemandShares, task: Task, weights: Weights, *, offset: float
) -> list[float]:
    """``offset`` plus the resource part of the total at every edge, less the penalty where the task does not
    fit.
    """
    rows = list_resource_rows(ledger, shares, task)
    totals = _add_terms(ledger, shares, task, weights, rows[-1], offset)
    for edge in _find_infeasible_edges(rows):
        totals[edge] -= INFEASIBLE_PENALTY
    return totals


def compute_unlimited_totals(
    ledger: Ledger, shares: DemandShares, task: Task, weights: Weights
) -> list[float]:
    """The resource part of the total at every edge, whether the task fits there or not."""
    return _add_terms(ledger, shares, task, weights, _find_link_rows(ledger, shares, task), 0.0)


def _add_terms(
    ledger: Ledger, shares: DemandShares, task: Task, weights: Weights, links: ResourceRows, offset: float
) -> list[float]:
    weight = weights[NETWORK.name]
    columns = zip(
        ledger.weigh_free(weights),
        shares.of_weighted(task, weights),
        links.free,
        links.demanded,
        strict=False,
    )  # the free rows go on to the robots
    return [
        offset + free - demanded + weight * (free_link - demanded_link)
        for free, demanded, free_link, demanded_link in columns
    ]


def list_resource_rows(ledger: Ledger, shares: DemandShares, task: Task) -> list[ResourceRows]:
    """The rows of every resource of hosts that may limit the task, and of the links as the last."""
    rows = [
        _find_host_row(ledger, shares, task, name) for name in list_limiting_resources(ledger.fleet, task)
    ]
    rows.append(_find_link_rows(ledger, shares, task))
    return rows


def _find_infeasible_edges(rows: Sequence[ResourceRows]) -> set[int]:
    """Edges that lack some resource. A comparison of two rows in C tells whether there may be any."""
    return {
        edge
        for row in rows
        if not row.fits and any(map(lt, row.free, row.demanded))
        for edge, term in enumerate(_subtract_rows(row))
        if term < -EPSILON
    }


def compute_worst_terms(ledger: Ledger, shares: DemandShares, task: Task) -> list[float]:
    """The least UT of the resources at every edge: how far the task is from fitting."""
    return list(map(min, *map(_subtract_rows, list_resource_rows(ledger, shares, task))))
