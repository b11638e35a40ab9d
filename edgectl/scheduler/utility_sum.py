# SPDX-License-Identifier: Apache-2.0
"""The sum of utilities of a packing, kept up to date change by change (ADR 66). Pure."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from edgectl.dataclass import dataclass
from edgectl.model.policy import Weights
from edgectl.model.resource import AFFINITY, HOST_RESOURCES, NETWORK
from edgectl.scheduler.packing import Item, Packing, keeps_limits
from edgectl.scheduler.utility import EPSILON, compute_affinity, task_utilities

_HOST = tuple(enumerate(HOST_RESOURCES))

# New places of items.
Goals = Mapping[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Objective:
    """Sum over all placed tasks of eq. (4) at the loads after the whole plan.

    ``links``: the columns of each task's links; ``needs`` and ``successors``: its predecessors, and the tasks
    that it is a predecessor of. ``elsewhere``: places of predecessors that the plan does not decide.
    """

    weights: Weights
    edges: int
    links: Mapping[str, Sequence[int]]
    needs: Mapping[str, Sequence[str]]
    successors: Mapping[str, Sequence[str]]
    elsewhere: Mapping[str, int]

    def rate(self, packing: Packing, names: Iterable[str]) -> float:
        """The sum over the tasks ``names``."""
        return sum(self._rate_task(packing, name) for name in names)

    def _rate_task(self, packing: Packing, name: str) -> float:
        place = packing.at[name]
        row = packing.free[place]
        total = 0.0
        for column, resource in enumerate(HOST_RESOURCES):
            total += self.weights[resource.name] * row[column]
        links = self.links[name] if place < self.edges else ()
        total += self.weights[NETWORK.name] * min([row[column] for column in links], default=1.0)
        return total + self.weights[AFFINITY] * self.rate_affinity(packing, name)

    def rate_affinity(self, packing: Packing, name: str) -> float:
        """UT_task of one task."""
        place = packing.at[name]
        known = (packing.at.get(need, self.elsewhere.get(need)) for need in self.needs[name])
        located = [there for there in known if there is not None]
        if not located:
            return 0.5
        rewards = {compute_affinity(located, each) for each in (*packing.items[name].places, place)}
        return task_utilities(rewards)[compute_affinity(located, place)]


@dataclass(slots=True, kw_only=True)
class Part:
    """What one item adds to the sum.

    ``rates``: weighted share of the resources of its host, by place; ``loads``: of its link. ``column``: of
    its only link, None without one. ``alone``: it changes no affinity, and shares no link with an item of
    several links.
    """

    item: Item
    rates: dict[int, float]
    loads: dict[int, float]
    column: int | None
    alone: bool


@dataclass(slots=True, kw_only=True)
class UtilitySum:
    """``free``: weighted free share of the resources of each host. ``users``: items by place and only link.

    ``value``: gain since the start, less ``margin`` for each running item away from home.
    """

    packing: Packing
    objective: Objective
    margin: float
    parts: dict[str, Part]
    free: list[float]
    users: list[dict[int, int]]
    value: float = 0.0


def build_utility_sum(
    packing: Packing, objective: Objective, margin: float, names: Sequence[str]
) -> UtilitySum:
    """The sum over all items of ``packing``; ``names``: those that may be moved."""
    weights = objective.weights
    shared = {
        column for name in packing.at if len(objective.links[name]) > 1 for column in objective.links[name]
    }
    parts = {}
    for name in packing.at:
        item, links = packing.items[name], objective.links[name]
        parts[name] = Part(
            item=item,
            rates={},
            loads={},
            column=links[0] if links else None,
            alone=not (objective.needs[name] or objective.successors[name] or shared.intersection(links)),
        )
    found = UtilitySum(
        packing=packing,
        objective=objective,
        margin=margin,
        parts=parts,
        free=[sum(weights[each.name] * row[column] for column, each in _HOST) for row in packing.free],
        users=[{} for _ in packing.free],
    )
    for name, place in packing.at.items():
        _measure_part(found, name, place)
        _count_user(found, parts[name], place, 1)
    for name in names:
        for place in packing.items[name].places:
            _measure_part(found, name, place)
    return found


def _measure_part(found: UtilitySum, name: str, place: int) -> None:
    part, weights = found.parts[name], found.objective.weights
    shares = part.item.shares[place]
    part.rates[place] = sum(weights[each.name] * shares.get(column, 0.0) for column, each in _HOST)
    if part.column is not None:
        part.loads[place] = weights[NETWORK.name] * shares.get(part.column, 0.0)


def _count_user(found: UtilitySum, part: Part, place: int, count: int) -> None:
    if part.column is not None:
        users = found.users[place]
        users[part.column] = users.get(part.column, 0) + count


def weigh_relocations(found: UtilitySum, name: str) -> Iterator[tuple[int, float]]:
    """The places where one item alone would gain, and how much, without the margin and whether it fits."""
    packing, part = found.packing, found.parts[name]
    here = packing.at[name]
    leaving = _value_leaving(found, part, here)
    free, on, rates = found.free, packing.on, part.rates
    weight = found.objective.weights[NETWORK.name]
    for place in part.item.places:
        if place == here:
            continue
        gain = leaving + free[place] - (len(on[place]) + 1) * rates[place]
        if weight < 0.0 or gain + weight > EPSILON:  # a link adds no more than its weight
            gain += _value_link(found, part, place)
            if gain > EPSILON:
                yield place, gain


def _value_leaving(found: UtilitySum, part: Part, here: int) -> float:
    """Change of the sum where ``part`` leaves its place."""
    change = (len(found.packing.on[here]) - 1) * part.rates[here] - found.free[here]
    if part.column is None or here >= found.objective.edges:
        return change - found.objective.weights[NETWORK.name]
    share = found.objective.weights[NETWORK.name] * found.packing.free[here][part.column]
    return change + (found.users[here][part.column] - 1) * part.loads[here] - share


def _value_link(found: UtilitySum, part: Part, place: int) -> float:
    """Change of the sum of the network terms where ``part`` comes to ``place``."""
    weight = found.objective.weights[NETWORK.name]
    if part.column is None or place >= found.objective.edges:
        return weight
    users = found.users[place].get(part.column, 0)
    return weight * found.packing.free[place][part.column] - (users + 1) * part.loads[place]


def weigh_goals(found: UtilitySum, goals: Goals) -> float:
    """What the sum gains if items go to their ``goals``, less the margin for running ones that leave home."""
    parts = found.parts
    for name, place in goals.items():
        if place not in parts[name].rates:
            _measure_part(found, name, place)
    gain = _weigh_hosts(found, goals) + weigh_links(found, goals) + _weigh_affinity(found, goals)
    return gain - found.margin * count_leaving(found.packing, goals)


def _weigh_affinity(found: UtilitySum, goals: Goals) -> float:
    """Change of the sum of the affinities of the items and of their successors."""
    packing, objective = found.packing, found.objective
    touched = {each for name in goals for each in (name, *objective.successors[name]) if each in packing.at}
    touched = {name for name in touched if objective.needs[name]}
    if not touched:
        return 0.0
    before = {name: packing.at[name] for name in goals}
    old = sum(objective.rate_affinity(packing, name) for name in sorted(touched))
    packing.at |= goals
    new = sum(objective.rate_affinity(packing, name) for name in sorted(touched))
    packing.at |= before
    return objective.weights[AFFINITY] * (new - old)


def count_leaving(packing: Packing, goals: Goals) -> int:
    """Running items that leave their home, less those that come back to it."""
    count = 0
    for name, goal in goals.items():
        if packing.items[name].runs:
            home = packing.home[name]
            count += (goal != home) - (packing.at[name] != home)
    return count


def _weigh_hosts(found: UtilitySum, goals: Goals) -> float:
    """Change of the sum of the terms of hosts: the tasks at a place times what is free there."""
    packing, counts, free = found.packing, dict[int, int](), dict[int, float]()
    for name, goal in goals.items():
        here, rates = packing.at[name], found.parts[name].rates
        counts[here] = counts.get(here, 0) - 1
        counts[goal] = counts.get(goal, 0) + 1
        free[here] = free.get(here, 0.0) + rates[here]
        free[goal] = free.get(goal, 0.0) - rates[goal]
    change = 0.0
    for place, more in counts.items():
        there = len(packing.on[place])
        change += (there + more) * (found.free[place] + free[place]) - there * found.free[place]
    return change


def weigh_links(found: UtilitySum, goals: Goals) -> float:
    """Change of the sum of the network terms."""
    packing, objective = found.packing, found.objective
    weight = objective.weights[NETWORK.name]
    if weight == 0.0 or not any(objective.links[name] for name in goals):
        return 0.0
    change = 0.0
    for place in {*goals.values(), *(packing.at[name] for name in goals)}:
        comes = [name for name, goal in goals.items() if goal == place]
        leaves = [name for name in goals if packing.at[name] == place]
        change += _weigh_links_at(found, place, comes, leaves)
    return weight * change


def _weigh_links_at(found: UtilitySum, place: int, comes: Sequence[str], leaves: Sequence[str]) -> float:
    packing, links = found.packing, found.objective.links
    if place >= found.objective.edges:
        return float(len(comes) - len(leaves))
    row = packing.free[place]
    changes: dict[int, float] = {}
    for names, sign in ((leaves, 1.0), (comes, -1.0)):
        for name in names:
            shares = packing.items[name].shares[place]
            for column in links[name]:
                changes[column] = changes.get(column, 0.0) + sign * shares.get(column, 0.0)
    total = 0.0
    for name in packing.on[place]:
        columns = links[name]
        old = min([row[column] for column in columns], default=1.0)
        if name in leaves:
            total -= old
        elif any(column in changes for column in columns):
            total += min([row[column] + changes.get(column, 0.0) for column in columns]) - old
    for name in comes:
        total += min([row[column] + changes.get(column, 0.0) for column in links[name]], default=1.0)
    return total


def fits_goals(packing: Packing, goals: Goals) -> bool:
    """Whether ``goals`` have room for their items once these have left their places, and may take them."""
    added: dict[int, dict[int, float]] = {goal: {} for goal in goals.values()}
    for name, goal in goals.items():
        item, comes = packing.items[name], added[goal]
        for column, share in item.shares[goal].items():
            comes[column] = comes.get(column, 0.0) + share
    for name in goals:
        here = packing.at[name]
        if here in added:
            comes = added[here]
            for column, share in packing.items[name].shares[here].items():
                if column in comes:
                    comes[column] -= share
    for goal, shares in added.items():
        row = packing.free[goal]
        for column, share in shares.items():
            if row[column] - share < -EPSILON:
                return False
    return keeps_limits(packing, goals)


def move_items(found: UtilitySum, goals: Goals) -> None:
    """Put items to their ``goals``."""
    packing, parts = found.packing, [found.parts[name] for name in goals]
    for part in parts:
        place = packing.take(part.item)
        found.free[place] += part.rates[place]
        _count_user(found, part, place, -1)
    for part in parts:
        place = goals[part.item.name]
        packing.put(part.item, place)
        found.free[place] -= part.rates[place]
        _count_user(found, part, place, 1)
