"""Relocations and swaps that raise the sum of utilities of a whole plan (ADR 66). Pure and deterministic."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf

from edgectl.model.policy import Weights
from edgectl.model.resource import AFFINITY, HOST_RESOURCES, NETWORK
from edgectl.scheduler.packing import Item, Packing, Shares, keeps_limits
from edgectl.scheduler.utility import EPSILON, compute_affinity, task_utilities

# Relocations and swaps that are weighed: some 0.1 s.
MAX_TRIALS = 12_000
# Pairs of an item and a place that are measured.
MAX_PAIRS = 50_000
# Disturbed plans in a row that lead to nothing better, after which the search ends; items that one disturbs.
MAX_VAIN, KICKED = 20, 4
# What links are taken to add to a swap at most: others are not weighed to the end.
SMALL_LINK_GAIN = 0.02


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
class _Part:
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
class _Search:
    """A packing whose sum of utilities is kept up to date change by change.

    ``free``: weighted free share of the resources of each host. ``users``: items by place and only link.
    ``value``: gain since the start, less the margin for each running item away from home. ``left``: trials.
    """

    packing: Packing
    objective: Objective
    margin: float
    parts: dict[str, _Part]
    free: list[float]
    users: list[dict[int, int]]
    names: list[str]
    value: float = 0.0
    left: int = MAX_TRIALS


_HOST = tuple(enumerate(HOST_RESOURCES))


def rebalance_packing(packing: Packing, objective: Objective, margin: float) -> None:
    """Relocate and swap items until nothing gains, then again from disturbed plans, and keep the best.

    Each running item that leaves its home must gain more than ``margin`` to the sum.
    """
    names = [name for name in packing.at if packing.items[name].movable]
    if len(names) * len(packing.free) > MAX_PAIRS:
        names = names[: max(1, MAX_PAIRS // len(packing.free))]
    search = _build_search(packing, objective, margin, names)
    _climb(search)
    best, at, vain = search.value, dict(packing.at), 0
    while names and search.left > 0 and vain < MAX_VAIN:
        for _ in range(KICKED):
            _kick(search)
        _climb(search)
        if search.value > best + EPSILON:
            best, at, vain = search.value, dict(packing.at), 0
        else:
            _move(search, {name: place for name, place in at.items() if packing.at[name] != place})
            search.value = best
            vain += 1
    _move(search, {name: place for name, place in at.items() if packing.at[name] != place})


def _build_search(packing: Packing, objective: Objective, margin: float, names: list[str]) -> _Search:
    weights = objective.weights
    shared = {
        column for name in packing.at if len(objective.links[name]) > 1 for column in objective.links[name]
    }
    parts = {}
    for name in packing.at:
        item, links = packing.items[name], objective.links[name]
        parts[name] = _Part(
            item=item,
            rates={},
            loads={},
            column=links[0] if links else None,
            alone=not (objective.needs[name] or objective.successors[name] or shared.intersection(links)),
        )
    search = _Search(
        packing=packing,
        objective=objective,
        margin=margin,
        parts=parts,
        free=[sum(weights[each.name] * row[column] for column, each in _HOST) for row in packing.free],
        users=[{} for _ in packing.free],
        names=names,
    )
    for name, place in packing.at.items():
        _measure_part(search, name, place)
        _count_user(search, parts[name], place, 1)
    for name in names:
        for place in packing.items[name].places:
            _measure_part(search, name, place)
    return search


def _measure_part(search: _Search, name: str, place: int) -> None:
    part, weights = search.parts[name], search.objective.weights
    shares = search.packing.measure(part.item, place)
    part.rates[place] = sum(weights[each.name] * shares.get(column, 0.0) for column, each in _HOST)
    if part.column is not None:
        part.loads[place] = weights[NETWORK.name] * shares.get(part.column, 0.0)


def _count_user(search: _Search, part: _Part, place: int, count: int) -> None:
    if part.column is not None:
        users = search.users[place]
        users[part.column] = users.get(part.column, 0) + count


def _climb(search: _Search) -> None:
    """Take each relocation and each swap that gains, until none is left or the trials are used up."""
    improved = True
    while improved and search.left > 0:
        improved = False
        for index, name in enumerate(search.names):
            improved |= _relocate(search, name)
            improved |= _swap(search, name, search.names[index + 1 :])
            if search.left <= 0:
                return


def _relocate(search: _Search, name: str) -> bool:
    """Put one item to the first place where that gains."""
    packing, part = search.packing, search.parts[name]
    here = packing.at[name]
    search.left -= len(part.item.places)
    if not part.alone:
        return any(place != here and _try(search, {name: place}, EPSILON) for place in part.item.places)
    leaving = _value_leaving(search, part, here)
    free, on, rates = search.free, packing.on, part.rates
    for place in part.item.places:
        if place == here:
            continue
        gain = leaving + free[place] - (len(on[place]) + 1) * rates[place]
        weight = search.objective.weights[NETWORK.name]
        if weight < 0.0 or gain + weight > EPSILON:  # a link adds no more than its weight
            gain += _value_link(search, part, place)
            if gain > EPSILON and _take_gain(search, {name: place}, gain):
                return True
    return False


def _value_leaving(search: _Search, part: _Part, here: int) -> float:
    """Change of the sum where ``part`` leaves its place."""
    change = (len(search.packing.on[here]) - 1) * part.rates[here] - search.free[here]
    if part.column is None or here >= search.objective.edges:
        return change - search.objective.weights[NETWORK.name]
    share = search.objective.weights[NETWORK.name] * search.packing.free[here][part.column]
    return change + (search.users[here][part.column] - 1) * part.loads[here] - share


def _value_link(search: _Search, part: _Part, place: int) -> float:
    """Change of the sum of the network terms where ``part`` comes to ``place``."""
    weight = search.objective.weights[NETWORK.name]
    if part.column is None or place >= search.objective.edges:
        return weight
    users = search.users[place].get(part.column, 0)
    return weight * search.packing.free[place][part.column] - (users + 1) * part.loads[place]


def _swap(search: _Search, name: str, others: Sequence[str]) -> bool:
    """Swap one item with the first of ``others`` where that gains."""
    packing, parts = search.packing, search.parts
    part, at, on = parts[name], packing.at, packing.on
    here, rates = at[name], part.rates
    count, rate = len(on[here]), part.rates[here]
    search.left -= len(others)
    for other in others:
        there = at[other]
        if here == there:
            continue
        theirs = parts[other]
        if there not in rates or here not in theirs.rates or not (part.alone and theirs.alone):
            if _may_swap(packing, name, other) and _try(search, {name: there, other: here}, EPSILON):
                return True
            continue
        gain = count * (rate - theirs.rates[here]) + len(on[there]) * (theirs.rates[there] - rates[there])
        if gain > -SMALL_LINK_GAIN:
            gain += _weigh_links(search, {name: there, other: here})
            if gain > EPSILON and _take_gain(search, {name: there, other: here}, gain):
                return True
    return False


def _may_swap(packing: Packing, name: str, other: str) -> bool:
    return packing.at[other] in packing.items[name].places and packing.at[name] in packing.items[other].places


def _take_gain(search: _Search, goals: Mapping[str, int], gain: float) -> bool:
    """Move items for ``gain`` if that is worth it for running ones too, and they fit."""
    gain -= search.margin * _count_leaving(search.packing, goals)
    if gain <= EPSILON or not _fits_all(search.packing, goals):
        return False
    _move(search, goals)
    search.value += gain
    return True


def _kick(search: _Search) -> None:
    """Move one item drawn by lot to a place drawn by lot, or swap it with one there, whatever it costs."""
    packing = search.packing
    name = search.names[packing.draw(len(search.names))]
    places = packing.items[name].places
    if not places:
        return
    place = places[packing.draw(len(places))]
    if place == packing.at[name] or _try(search, {name: place}, -inf):
        return
    others = [other for other in packing.on[place] if packing.items[other].movable and other in search.parts]
    if others:
        other = others[packing.draw(len(others))]
        if _may_swap(packing, name, other):
            _try(search, {name: place, other: packing.at[name]}, -inf)


def _try(search: _Search, goals: Mapping[str, int], needed: float) -> bool:
    """Put items to their ``goals`` if they fit there and the sum gains more than ``needed``."""
    packing = search.packing
    for name, place in goals.items():
        if place not in search.parts[name].rates:
            _measure_part(search, name, place)
    if not _fits_all(packing, goals):
        return False
    gain = _weigh_hosts(search, goals) + _weigh_links(search, goals) + _weigh_affinity(search, goals)
    gain -= search.margin * _count_leaving(packing, goals)
    if gain <= needed:
        return False
    _move(search, goals)
    search.value += gain
    return True


def _weigh_affinity(search: _Search, goals: Mapping[str, int]) -> float:
    """Change of the sum of the affinities of the items and of their successors."""
    packing, objective = search.packing, search.objective
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


def _count_leaving(packing: Packing, goals: Mapping[str, int]) -> int:
    """Running items that leave their home, less those that come back to it."""
    count = 0
    for name, goal in goals.items():
        if packing.items[name].runs:
            home = packing.home[name]
            count += (goal != home) - (packing.at[name] != home)
    return count


def _weigh_hosts(search: _Search, goals: Mapping[str, int]) -> float:
    """Change of the sum of the terms of hosts: the tasks at a place times what is free there."""
    packing, free = search.packing, search.free
    if len(goals) == 1:
        ((name, there),) = goals.items()
        here = packing.at[name]
        leaves, comes = search.parts[name].rates[here], search.parts[name].rates[there]
        return (
            (len(packing.on[here]) - 1) * leaves
            - free[here]
            + free[there]
            - (len(packing.on[there]) + 1) * comes
        )
    (one, there), (other, here) = goals.items()
    mine, theirs = search.parts[one].rates, search.parts[other].rates
    return len(packing.on[here]) * (mine[here] - theirs[here]) + len(packing.on[there]) * (
        theirs[there] - mine[there]
    )


def _weigh_links(search: _Search, goals: Mapping[str, int]) -> float:
    """Change of the sum of the network terms."""
    packing, objective = search.packing, search.objective
    weight = objective.weights[NETWORK.name]
    if weight == 0.0 or not any(objective.links[name] for name in goals):
        return 0.0
    change = 0.0
    for place in {*goals.values(), *(packing.at[name] for name in goals)}:
        comes = [name for name, goal in goals.items() if goal == place]
        leaves = [name for name in goals if packing.at[name] == place]
        change += _weigh_links_at(search, place, comes, leaves)
    return weight * change


def _weigh_links_at(search: _Search, place: int, comes: Sequence[str], leaves: Sequence[str]) -> float:
    packing, links = search.packing, search.objective.links
    if place >= search.objective.edges:
        return float(len(comes) - len(leaves))
    row = packing.free[place]
    changes: dict[int, float] = {}
    for names, sign in ((leaves, 1.0), (comes, -1.0)):
        for name in names:
            shares = packing.measure(packing.items[name], place)
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


def _fits_all(packing: Packing, goals: Mapping[str, int]) -> bool:
    """Whether each of ``goals`` has room for its item once the others have left, and may take it."""
    leaving: dict[int, Shares] = {
        packing.at[name]: packing.measure(packing.items[name], packing.at[name]) for name in goals
    }
    for name, goal in goals.items():
        row, freed = packing.free[goal], leaving.get(goal, {})
        for column, share in packing.measure(packing.items[name], goal).items():
            if row[column] + freed.get(column, 0.0) - share < -EPSILON:
                return False
    return keeps_limits(packing, goals)


def _move(search: _Search, goals: Mapping[str, int]) -> None:
    packing = search.packing
    parts = [search.parts[name] for name in goals]
    for part in parts:
        place = packing.take(part.item)
        search.free[place] += part.rates[place]
        _count_user(search, part, place, -1)
    for part in parts:
        place = goals[part.item.name]
        packing.put(part.item, place)
        search.free[place] -= part.rates[place]
        _count_user(search, part, place, 1)
