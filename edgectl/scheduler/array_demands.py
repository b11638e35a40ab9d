# SPDX-License-Identifier: Apache-2.0
"""Measured demands of many tasks as arrays (ADR 147): shares of capacity by group of alike edges.

With a history of its own each task has other demands, so that rows of shares cannot be kept. They are
computed for a block of tasks at once, one number for each group (`edge_groups`), and spread over the edges
when the task is weighed. Every operation is that of ``scan``, element by element.
"""

from collections.abc import Mapping, Sequence
from dataclasses import field
from math import inf
from operator import itemgetter

import numpy as np

from edgectl.dataclass import dataclass
from edgectl.model.policy import Weights
from edgectl.model.resource import NETWORK
from edgectl.scheduler.array_types import Array, Flags, Indexes
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.demand import ClassDemands
from edgectl.scheduler.edge_groups import group_edges

# Numbers that one block holds: some 4 MiB.
MAX_BLOCK = 500_000


@dataclass(frozen=True, slots=True, kw_only=True)
class DemandBlock:
    """Tasks from number ``start`` on.

    ``shares``: by task, then by resource of hosts and as the last row the weighted sum, each by group of
    edges. ``rates``: bytes/s by task and class of hosts; ``shared``: by task, whether one is a share of
    what a link carries; ``even``: whether they are the same on all classes.
    """

    start: int
    shares: Array
    rates: Array
    shared: list[bool]
    even: list[bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredRows:
    """Demands of tasks with a history, ``names``, in the order in which they will be asked for; ``index``:
    the number of each.

    ``kinds``: classes of hosts. ``kind_of``: by group of edges. ``raw`` and ``usable``: by each of
    ``resources``, those of hosts that count, and group. ``spread``: where each of the rows of a task takes
    the number for each edge from. ``size``: tasks of a block. ``blocks``: the last one that was made.
    """

    demands: Mapping[str, ClassDemands]
    names: Sequence[str]
    index: Mapping[str, int]
    weights: Weights
    resources: tuple[str, ...]
    kinds: Sequence[str]
    kind_of: Indexes
    raw: Array
    usable: Array
    spread: Indexes
    size: int
    blocks: list[DemandBlock] = field(default_factory=list)

    def find_shares(self, number: int) -> Array:
        """D / Delta of one task: a row for each resource of hosts by edge, and the weighted sum."""
        block = self._get_block(number)
        row: Array = block.shares[number - block.start].take(self.spread)
        return row

    def find_weighted(self, number: int) -> Array:
        """The weighted sum of ``find_shares`` alone."""
        block = self._get_block(number)
        row: Array = block.shares[number - block.start].take(self.spread[-1])
        return row

    def find_rates(self, number: int) -> "Array | float | None":
        """Bytes/s of one task, by class of hosts or the same on all; None: a share of what a link carries."""
        block = self._get_block(number)
        at = number - block.start
        if block.shared[at]:
            return None
        rates: Array = block.rates[at]
        return float(rates[0]) if block.even[at] else rates

    def _get_block(self, number: int) -> DemandBlock:
        if not self.blocks or not 0 <= number - self.blocks[0].start < self.size:
            self.blocks[:] = [self._build_block(number // self.size * self.size)]
        return self.blocks[0]

    def _build_block(self, start: int) -> DemandBlock:
        names = self.names[start : start + self.size]
        shares: Array = np.zeros((len(names), len(self.resources) + 1, self.raw.shape[1]))
        stated, percent = self._list_amounts(names)
        for index, name in enumerate(self.resources):
            amounts, relative = stated[:, :, index].take(self.kind_of, axis=1), percent[:, :, index]
            raw, usable = self.raw[index], self.usable[index]
            if relative.any():
                with np.errstate(invalid="ignore"):
                    shared = np.where(raw != inf, amounts * raw, 0.0)
                amounts = np.where(relative.take(self.kind_of, axis=1), shared, amounts)
            np.divide(amounts, usable, out=shares[:, index], where=usable > 0)
            shares[:, -1] += self.weights[name] * shares[:, index]
        rates = stated[:, :, -1].copy()
        return DemandBlock(
            start=start,
            shares=shares.reshape(len(names), -1),
            rates=rates,
            shared=np.logical_or.reduce(percent[:, :, -1], axis=1).tolist(),
            even=(rates == rates[:, :1]).all(axis=1).tolist(),
        )

    def _list_amounts(self, names: Sequence[str]) -> tuple[Array, Flags]:
        """By task, class of hosts and resource, the network last: the demand, and whether it is a share."""
        resources = *self.resources, NETWORK.name
        pick = itemgetter(*resources)
        amounts: list[float] = []
        percent: list[int] = []
        for name in names:
            demands = self.demands[name]
            for kind in self.kinds:
                try:
                    amounts += pick(demands.get_measured(kind))
                except KeyError:  # not all of it is as measured there
                    for quantity in demands.list_quantities(kind, resources):
                        if quantity.relative:
                            percent.append(len(amounts))
                        amounts.append(quantity.value)
        relative: Flags = np.zeros(len(amounts), bool)
        relative[percent] = True
        shape = len(names), len(self.kinds), len(resources)
        return np.array(amounts, float).reshape(shape), relative.reshape(shape)


def build_measured_rows(
    fleet: Capacities, names: Sequence[str], kinds: Sequence[str], kind_of: Indexes, weights: Weights
) -> MeasuredRows:
    """The demands of ``names`` in ``fleet``, nothing computed yet. ``kind_of``: by edge."""
    edges = fleet.edges
    raw, usable = ({name: each[name][:edges] for name in fleet.counted} for each in (fleet.raw, fleet.usable))
    columns = kind_of.tolist(), *raw.values(), *usable.values()
    groups = group_edges(columns, edges)
    first, group_of = list(groups.first), np.array(groups.expand(range(len(groups.first))), dtype=np.intp)
    rows = len(fleet.counted) + 1
    return MeasuredRows(
        demands=fleet.demands,
        names=names,
        index={name: number for number, name in enumerate(names)},
        weights=weights,
        resources=fleet.counted,
        kinds=kinds,
        kind_of=kind_of[first],
        raw=np.array(list(raw.values()))[:, first],
        usable=np.array(list(usable.values()))[:, first],
        spread=group_of + len(first) * np.arange(rows)[:, np.newaxis],
        size=max(1, MAX_BLOCK // (rows * len(first))),
    )
