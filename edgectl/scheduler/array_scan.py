# SPDX-License-Identifier: Apache-2.0
"""Equation (4) for one task at every edge at once, in NumPy: for fleets of very many pairs (ADR 0076).

Every operation is that of ``scan``, element by element and in the same order, so that all numbers are the
same to the last bit. Imported only where it pays and where NumPy is installed.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from math import inf

import numpy as np

from edgectl.dataclass import dataclass
from edgectl.model.demand import ZERO, Demand, Quantity
from edgectl.model.policy import Weights
from edgectl.model.resource import NETWORK, NOTHING
from edgectl.model.task import Task
from edgectl.scheduler.array_demands import MeasuredRows, build_measured_rows
from edgectl.scheduler.array_types import Array, Indexes
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.demand import OTHER_CLASS
from edgectl.scheduler.ledger import NO_FREE_SHARE, Ledger
from edgectl.scheduler.scan import (
    EXCLUDED_TOTAL,
    INFEASIBLE_PENALTY,
    MAX_CACHED_SHARES,
    is_feasible_total,
    list_uncounted_demands,
)
from edgectl.scheduler.utility import EPSILON


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrayShares:
    """Demands as shares of capacity at every edge, as ``scan.DemandShares`` has them.

    ``raw`` and ``usable``: one row for each of ``names``, the resources of hosts that count. ``kinds`` are
    the classes of hosts, ``kind_of`` the index of each edge's class. ``stated`` is what is kept of tasks
    without a history of their own: rows and weighted sum by quantities; ``measured`` is of the others.
    ``units``: of the links to one robot, what one byte/s is a share of, and what the nominal capacity is;
    ``divisors``: their capacities, infinite where there is none.
    """

    fleet: Capacities
    names: tuple[str, ...]
    raw: Array
    usable: Array
    links: dict[str, Array]
    nominal_links: dict[str, Array]
    kinds: tuple[str, ...]
    kind_of: Indexes
    measured: MeasuredRows
    stated: dict[object, tuple[Array, Array]] = field(default_factory=dict)
    units: dict[tuple[str, bool], Array] = field(default_factory=dict)
    divisors: dict[str, Array] = field(default_factory=dict)

    def of_hosts(self, task: Task, weights: Weights) -> tuple[Array, Array]:
        """D / Delta of the resources of hosts, one row each, and the sum of weight x (d / Delta)."""
        number, floor = self.measured.index.get(task.name), self.fleet.floors.get(task.name)
        if number is None:
            rows, weighted = self._get_stated_rows(task.demand, weights)
        else:
            found = self.measured.find_shares(number)
            rows, weighted = found[:-1], found[-1]
        if floor is None:
            return rows, weighted
        rows = rows.copy()
        for index, name in enumerate(self.names):
            if name in floor.used:
                rows[index] = _raise(rows[index], floor.used[name], self.usable[index])
        return rows, self._add_weighted(rows, weights)

    def weigh_hosts(self, task: Task, weights: Weights) -> Array:
        """The weighted sum of `of_hosts` alone, of a task that was not measured to use more."""
        number = self.measured.index.get(task.name)
        if number is None:
            return self._get_stated_rows(task.demand, weights)[1]
        return self.measured.find_weighted(number)

    def _get_stated_rows(self, demand: Demand, weights: Weights) -> tuple[Array, Array]:
        quantities = [demand[name] or ZERO for name in self.names]
        # Numbers: the hash of a quantity costs as much as a row operation.
        key = tuple([number for each in quantities for number in (each.value, each.relative)])
        found = self.stated.get(key)
        if found is None:
            rows = self._build_rows([[quantity] for quantity in quantities])
            if len(self.stated) * self.fleet.edges > MAX_CACHED_SHARES / len(self.names):
                self.stated.clear()
            found = self.stated[key] = rows, self._add_weighted(rows, weights)
        return found

    def _add_weighted(self, rows: Array, weights: Weights) -> Array:
        """The sum of weight x share over the resources of hosts."""
        total: Array = np.zeros(rows.shape[1])
        for name, row in zip(self.names, rows, strict=True):
            total += weights[name] * row
        return total

    def _build_rows(self, quantities: Sequence[Sequence[Quantity]]) -> Array:
        """Rho / Delta by resource of hosts and edge; ``quantities`` by resource, and by class or of all."""
        return _divide(self._list_amounts(quantities, self.raw), self.usable)

    def _list_amounts(self, quantities: Sequence[Sequence[Quantity]], whole: Array) -> Array:
        """The amounts by row and edge, in the unit of ``whole``, the capacities that a share is of."""
        amounts: Array = np.array([[each.value for each in row] for row in quantities])
        relative = np.array([[each.relative for each in row] for row in quantities])
        if amounts.shape[1] > 1:
            amounts = amounts.take(self.kind_of, axis=1)
            relative = relative.take(self.kind_of, axis=1) if relative.any() else relative
        if not relative.any():
            return np.broadcast_to(amounts, whole.shape)
        with np.errstate(invalid="ignore"):
            shared: Array = np.where(whole != inf, amounts * whole, 0.0)
        return np.where(relative, shared, amounts)

    def of_link(self, task: Task, robot: str) -> Array:
        """D / Delta of every edge's link to ``robot``."""
        number, floor = self.measured.index.get(task.name), self.fleet.floors.get(task.name)
        if number is None:
            stated = task.demand[NETWORK.name] or ZERO
            row = stated.value * self._get_unit(robot, relative=stated.relative)
        else:
            row = self._build_measured_link(task, number, robot)
        if floor is None or robot not in floor.links:
            return row
        return _raise(row, floor.links[robot], self.links[robot])

    def _build_measured_link(self, task: Task, number: int, robot: str) -> Array:
        rates = self.measured.find_rates(number)
        if rates is None:
            found = self.fleet.demands[task.name]
            quantities = [[found.at(kind)[NETWORK.name] or ZERO for kind in self.kinds]]
            rates = self._list_amounts(quantities, self.nominal_links[robot][np.newaxis])[0]
        elif not isinstance(rates, float):
            rates = rates.take(self.kind_of)
        divisor = self.divisors.get(robot)
        if divisor is None:
            capacity = self.links[robot]
            divisor = self.divisors[robot] = np.where(capacity > 0.0, capacity, inf)
        row: Array = rates / divisor
        return row

    def _get_unit(self, robot: str, *, relative: bool) -> Array:
        """By edge, one byte/s of the link to ``robot`` as a share of what it carries now; or its nominal
        capacity.
        """
        unit = self.units.get((robot, relative))
        if unit is None:
            capacity = self.links[robot]
            unit = _divide(np.ones(len(capacity)), capacity)
            if relative and self.fleet.nominal_links[robot] == self.fleet.links[robot]:
                unit = np.ones(len(capacity))
            elif relative:
                unit = self.nominal_links[robot] * unit
            self.units[robot, relative] = unit
        return unit


def _divide(amounts: Array, capacity: Array) -> Array:
    """The amounts as shares; 0 where there is no capacity."""
    return np.divide(amounts, capacity, out=np.zeros(capacity.shape), where=capacity > 0)


def _raise(row: Array, amount: float, capacity: Array) -> Array:
    """The shares, none below that of ``amount``."""
    least = np.divide(amount, capacity, out=np.zeros(len(capacity)), where=capacity != 0.0)
    return np.where(capacity != 0.0, np.maximum(row, least), 0.0)


def build_array_shares(fleet: Capacities, weights: Weights, names: Iterable[str]) -> ArrayShares:
    """Empty shares of ``fleet``. ``names``: of the tasks, in the order in which they will be asked for."""
    edges = fleet.edges
    kinds = tuple(dict.fromkeys(fleet.classes[:edges])) or (OTHER_CLASS,)
    places = {kind: index for index, kind in enumerate(kinds)}
    kind_of = np.array([places[kind] for kind in fleet.classes[:edges]] or [0] * edges, dtype=np.intp)
    measured = [name for name in names if name in fleet.demands]
    links = _build_link_arrays(fleet.links)
    return ArrayShares(
        fleet=fleet,
        names=fleet.counted,
        raw=np.array([fleet.raw[name][:edges] for name in fleet.counted]),
        usable=np.array([fleet.usable[name][:edges] for name in fleet.counted]),
        links=links,
        nominal_links=links
        if fleet.nominal_links == fleet.links
        else _build_link_arrays(fleet.nominal_links),
        kinds=kinds,
        kind_of=kind_of,
        measured=build_measured_rows(fleet, measured, kinds, kind_of, weights),
    )


def _build_link_arrays(links: Mapping[str, Sequence[float | None]]) -> dict[str, Array]:
    return {
        robot: np.array([each or 0.0 for each in row] if None in row else row) for robot, row in links.items()
    }


@dataclass(slots=True, kw_only=True)
class FreeArrays:
    """The free shares of a ledger by edge, kept in step with it. ``free``: one row for each resource of hosts
    that counts, ``rows``: the same by name. ``weighted``: under ``weights``.
    """

    free: Array
    rows: Mapping[str, Array]
    free_links: dict[str, Array]
    weighted: Array

    def set_free(self, place: int, name: str, share: float) -> None:
        """Follow a change of one resource."""
        row = self.rows.get(name)
        if row is not None and place < len(row):
            row[place] = share

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

    def list_at_least(self, level: float, first: int) -> list[int]:
        """The places whose total is ``level`` or more, in order. ``first``: the first of the greatest, which
        is one of them.
        """
        row = self.row
        top, row[first] = row[first], EXCLUDED_TOTAL
        second = row[row.argmax()]
        row[first] = top
        if second < level:
            return [first]  # the common case: a scan that makes no array
        places: list[int] = (row >= level).nonzero()[0].tolist()
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
        free: Array = np.array([ledger.free[name][:edges] for name in self.shares.names])
        ledger.mirror = FreeArrays(
            free=free,
            rows=dict(zip(self.shares.names, free, strict=True)),  # each a view of its row
            free_links={robot: np.array(row) for robot, row in ledger.free_links.items()},
            weighted=np.array(ledger.weigh_free(self.weights)[:edges]),
        )

    def compute_totals(self, free: FreeArrays, task: Task, *, offset: float) -> ArrayTotals:
        """As ``scan.compute_resource_totals``, with ``EXCLUDED_TOTAL`` for the robots after the edges."""
        shares, edges = self.shares, self.shares.fleet.edges
        demanded, weighted = shares.of_hosts(task, self.weights)
        terms: Array = np.empty((len(shares.names) + 1, edges))
        np.subtract(free.free, demanded, out=terms[:-1])
        links = terms[-1]
        fill_link_terms(links, free, shares, task)
        row: Array = np.empty(len(shares.fleet.places))
        row[edges:] = EXCLUDED_TOTAL
        totals = np.add(free.weighted, offset, out=row[:edges])
        totals -= weighted
        totals += self.weights[NETWORK.name] * links
        if _demands_nothing_had(shares.fleet, task):
            totals -= INFEASIBLE_PENALTY
        if terms.min() < -EPSILON:
            totals[(terms < -EPSILON).any(axis=0)] -= INFEASIBLE_PENALTY
        return ArrayTotals(row)


def _demands_nothing_had(fleet: Capacities, task: Task) -> bool:
    """Whether the task demands some of what no host has any of."""
    return any(NOTHING in fleet.raw[name] for name in list_uncounted_demands(fleet, task))


def build_array_scan(fleet: Capacities, weights: Weights, names: Iterable[str]) -> ArrayScan:
    """The scan of ``fleet``, nothing computed yet. ``names``: of the tasks, in sequence order."""
    return ArrayScan(shares=build_array_shares(fleet, weights, names), weights=weights)


def fill_link_terms(terms: Array, mirror: FreeArrays, shares: ArrayShares, task: Task) -> None:
    """UT_net at every edge: the worst of the task's links; 1 without a robot."""
    if len(task.robots) == 1 and task.robots[0] in mirror.free_links:
        robot = task.robots[0]
        np.subtract(mirror.free_links[robot], shares.of_link(task, robot), out=terms)
        return
    terms.fill(1.0 if not task.robots else inf)
    for robot in task.robots:
        row = mirror.free_links.get(robot)
        if row is None:
            terms.fill(NO_FREE_SHARE)
            return
        np.minimum(terms, row - shares.of_link(task, robot), out=terms)
