"""Equation (4) for one task at every edge at once, in NumPy: for fleets of very many pairs (ADR 0076).

Every operation is that of ``scan``, element by element and in the same order, so that all numbers are the
same to the last bit. Imported only where it pays and where NumPy is installed.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np
from numpy.typing import NDArray

from edgectl.model.policy import Weights
from edgectl.model.resource import HOST_RESOURCES, NETWORK
from edgectl.model.task import ZERO, Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.demand import OTHER_CLASS
from edgectl.scheduler.ledger import NO_FREE_SHARE, Ledger
from edgectl.scheduler.scan import EXCLUDED_TOTAL, INFEASIBLE_PENALTY, MAX_CACHED_SHARES, is_feasible_total
from edgectl.scheduler.utility import EPSILON

Array = NDArray[np.float64]
_HOST_NAMES = tuple(resource.name for resource in HOST_RESOURCES)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrayShares:
    """Demands as shares of capacity at every edge, as ``scan.DemandShares`` has them.

    ``kinds`` are the classes of hosts, ``kind_of`` the index of each edge's class.
    """

    fleet: Capacities
    raw: dict[str, Array]
    usable: dict[str, Array]
    links: dict[str, Array]
    nominal_links: dict[str, Array]
    kinds: tuple[str, ...]
    kind_of: NDArray[np.intp]
    rows: dict[object, Array] = field(default_factory=dict)
    weighed: dict[object, tuple[Array, Array]] = field(default_factory=dict)

    def of_host(self, task: Task, resource: str) -> Array:
        """D / Delta of a resource of hosts at every edge."""
        usable = self.usable[resource]
        key, quantities = self._find_quantities(task, resource)
        row = self.rows.get(key)
        if row is None:
            row = self._keep(key, _divide(self._list_amounts(quantities, self.raw[resource]), usable))
        floor = self.fleet.floors.get(task.name)
        if floor is None or resource not in floor.used:
            return row
        return _raise(row, floor.used[resource], usable)

    def of_hosts(self, task: Task, weights: Weights) -> tuple[Array, Array]:
        """D / Delta of the resources of hosts, one row each, and the sum of weight x (d / Delta)."""
        by_class = self.fleet.demands.get(task.name)
        if by_class is not None or task.name in self.fleet.floors:
            return self._weigh([self.of_host(task, name) for name in _HOST_NAMES], weights)
        demand = task.demand
        stated = [demand[name] or ZERO for name in _HOST_NAMES]
        # Numbers: the hash of a quantity costs as much as a row operation.
        key = tuple([number for each in stated for number in (each.value, each.relative)])
        found = self.weighed.get(key)
        if found is None:
            found = self._weigh([self.of_host(task, name) for name in _HOST_NAMES], weights)
            if len(self.weighed) * self.fleet.edges > MAX_CACHED_SHARES / len(_HOST_NAMES):
                self.weighed.clear()
            self.weighed[key] = found
        return found

    def _weigh(self, rows: Sequence[Array], weights: Weights) -> tuple[Array, Array]:
        total: Array = np.zeros(self.fleet.edges)
        for name, row in zip(_HOST_NAMES, rows, strict=True):
            total = total + weights[name] * row
        return np.array(rows), total

    def of_link(self, task: Task, robot: str) -> Array:
        """D / Delta of every edge's link to ``robot``."""
        capacity = self.links[robot]
        key, quantities = self._find_quantities(task, NETWORK.name)
        key = (robot, key)
        row = self.rows.get(key)
        if row is None:
            row = self._keep(key, self._build_link_row(task, robot, quantities, capacity))
        floor = self.fleet.floors.get(task.name)
        if floor is None or robot not in floor.links:
            return row
        return _raise(row, floor.links[robot], capacity)

    def _build_link_row(
        self, task: Task, robot: str, quantities: Sequence[tuple[float, bool]], capacity: Array
    ) -> Array:
        if task.name in self.fleet.demands:
            return _divide(self._list_amounts(quantities, self.nominal_links[robot]), capacity)
        value, relative = quantities[0]
        per_byte = _divide(np.ones(len(capacity)), capacity)
        return value * (self._list_per_nominal(robot, per_byte) if relative else per_byte)

    def _list_per_nominal(self, robot: str, per_byte: Array) -> Array:
        """The nominal capacity of every edge's link to ``robot`` as a share of what it carries now."""
        if self.fleet.nominal_links[robot] == self.fleet.links[robot]:
            return np.ones(self.fleet.edges)
        return self.nominal_links[robot] * per_byte

    def _find_quantities(self, task: Task, resource: str) -> tuple[object, list[tuple[float, bool]]]:
        """Value of rho, and whether it is a share, by class of hosts; the same everywhere if there is one."""
        by_class = self.fleet.demands.get(task.name)
        if by_class is None:
            stated = task.demand[resource] or ZERO
            return (resource, stated.value, stated.relative), [(stated.value, stated.relative)]
        other = by_class[OTHER_CLASS]
        found = [by_class.get(kind, other)[resource] or ZERO for kind in self.kinds]
        quantities = [(quantity.value, quantity.relative) for quantity in found]
        return (resource, tuple(quantities), True), quantities

    def _list_amounts(self, quantities: Sequence[tuple[float, bool]], whole: Array) -> Array:
        index = self.kind_of if len(quantities) > 1 else np.zeros(len(whole), dtype=np.intp)
        values: Array = np.array([value for value, _ in quantities])[index]
        if not any(relative for _, relative in quantities):
            return values
        relative = np.array([each for _, each in quantities])[index]
        with np.errstate(invalid="ignore"):
            shared: Array = np.where(whole != inf, values * whole, 0.0)
        return np.where(relative, shared, values)

    def _keep(self, key: object, row: Array) -> Array:
        if len(self.rows) * self.fleet.edges > MAX_CACHED_SHARES:
            self.rows.clear()
        self.rows[key] = row
        return row


def _divide(amounts: Array, capacity: Array) -> Array:
    """The amounts as shares; 0 where there is no capacity."""
    return np.divide(amounts, capacity, out=np.zeros(len(capacity)), where=capacity > 0)


def _raise(row: Array, amount: float, capacity: Array) -> Array:
    """The shares, none below that of ``amount``."""
    least = np.divide(amount, capacity, out=np.zeros(len(capacity)), where=capacity != 0.0)
    return np.where(capacity != 0.0, np.maximum(row, least), 0.0)


def build_array_shares(fleet: Capacities) -> ArrayShares:
    """Empty shares of ``fleet``."""
    edges = fleet.edges
    kinds = tuple(dict.fromkeys(fleet.classes[:edges])) or (OTHER_CLASS,)
    places = {kind: index for index, kind in enumerate(kinds)}
    return ArrayShares(
        fleet=fleet,
        raw={name: np.array(row[:edges]) for name, row in fleet.raw.items()},
        usable={name: np.array(row[:edges]) for name, row in fleet.usable.items()},
        links=_build_link_arrays(fleet.links),
        nominal_links=_build_link_arrays(fleet.nominal_links),
        kinds=kinds,
        kind_of=np.array([places[kind] for kind in fleet.classes[:edges]] or [0] * edges, dtype=np.intp),
    )


def _build_link_arrays(links: Mapping[str, Sequence[float | None]]) -> dict[str, Array]:
    return {robot: np.array([each or 0.0 for each in row]) for robot, row in links.items()}


@dataclass(slots=True, kw_only=True)
class FreeArrays:
    """The free shares of a ledger by edge, kept in step with it. ``free``: one row per resource of hosts.
    ``weighted``: under ``weights``.
    """

    free: Array
    free_links: dict[str, Array]
    weighted: Array

    def set_free(self, place: int, name: str, share: float) -> None:
        """Follow a change of one resource."""
        if place < len(self.weighted):
            self.free[_HOST_NAMES.index(name), place] = share

    def set_link(self, place: int, robot: str, share: float) -> None:
        """Follow a change of one link."""
        self.free_links[robot][place] = share

    def set_weighted(self, place: int, total: float) -> None:
        """Follow a change of the weighted sum."""
        if place < len(self.weighted):
            self.weighted[place] = total


class ArrayTotals:
    """Eq. (4) by place, as ``scan.ListTotals`` has it."""

    __slots__ = ("row",)

    def __init__(self, row: Array) -> None:
        self.row = row

    def __getitem__(self, place: int) -> float:
        return float(self.row[place])

    def __setitem__(self, place: int, total: float) -> None:
        self.row[place] = total

    def __iter__(self) -> Iterator[float]:
        return iter(self.row.tolist())

    def exclude(self, places: Collection[int]) -> None:
        """Take ``places`` out."""
        self.row[list(places)] = EXCLUDED_TOTAL

    def find_top(self) -> int | None:
        """The first feasible place with the greatest total."""
        top = int(self.row.argmax())
        return top if is_feasible_total(self.row[top]) else None

    def list_at_least(self, level: float) -> list[int]:
        """The places whose total is ``level`` or more, in order."""
        places: list[int] = (self.row >= level).nonzero()[0].tolist()
        return places

    def copy(self) -> "ArrayTotals":
        """An independent row with the same totals."""
        return ArrayTotals(self.row.copy())


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrayScan:
    """The scan of one assignment: shares of its fleet, and its weights."""

    shares: ArrayShares
    weights: Weights

    def mirror(self, ledger: Ledger) -> None:
        """Let arrays follow ``ledger`` from now on."""
        edges = ledger.fleet.edges
        ledger.mirror = FreeArrays(
            free=np.array([ledger.free[name][:edges] for name in _HOST_NAMES]),
            free_links={robot: np.array(row) for robot, row in ledger.free_links.items()},
            weighted=np.array(ledger.weigh_free(self.weights)[:edges]),
        )

    def compute_totals(self, free: FreeArrays, task: Task, *, offset: float) -> ArrayTotals:
        """As ``scan.compute_resource_totals``, with ``EXCLUDED_TOTAL`` for the robots after the edges."""
        shares, edges = self.shares, self.shares.fleet.edges
        demanded, weighted = shares.of_hosts(task, self.weights)
        terms: Array = np.empty((len(_HOST_NAMES) + 1, edges))
        np.subtract(free.free, demanded, out=terms[:-1])
        _fill_link_terms(terms[-1], free, shares, task)
        row: Array = np.empty(len(shares.fleet.places))
        row[edges:] = EXCLUDED_TOTAL
        totals = np.add(free.weighted, offset, out=row[:edges])
        totals -= weighted
        totals += self.weights[NETWORK.name] * terms[-1]
        if np.minimum.reduce(terms, axis=None) < -EPSILON:
            totals[(terms < -EPSILON).any(axis=0)] -= INFEASIBLE_PENALTY
        return ArrayTotals(row)


def build_array_scan(fleet: Capacities, weights: Weights) -> ArrayScan:
    """The scan of ``fleet``, nothing computed yet."""
    return ArrayScan(shares=build_array_shares(fleet), weights=weights)


def _fill_link_terms(terms: Array, mirror: FreeArrays, shares: ArrayShares, task: Task) -> None:
    """UT_net at every edge: the worst of the task's links; 1 without a robot."""
    terms.fill(1.0 if not task.robots else inf)
    for robot in task.robots:
        row = mirror.free_links.get(robot)
        if row is None:
            terms.fill(NO_FREE_SHARE)
            return
        np.minimum(terms, row - shares.of_link(task, robot), out=terms)
