"""Search for a place of one more task among tasks that may make room (ADR 64). Pure and deterministic.

Works on shares of capacity: ``free`` holds one row per place, one column per resource of hosts and per link.
An item fits where no column that it touches falls below 0. All columns of the host are touched, also with a
demand of 0: nothing is added to a host that is overcommitted already.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import inf
from operator import itemgetter

from edgectl.scheduler.placement_rules import OccupancyLimit
from edgectl.scheduler.utility import EPSILON

# Share of the capacity by column.
Shares = Mapping[int, float]
# Tasks that give way to one insertion, and insertions that are tried for one task at each level.
MAX_EJECTED, MAX_STEPS = 3, 400
# Relocations by chance after an ejection: they keep the search from going round in a circle.
SHAKES = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One task of the search, or several that share a place (``tasks``).

    ``places``: those that may take it, in order. ``measure`` gives its shares at one of them. ``runs``: its
    move would be a handoff. ``movable``: it may make room. ``evictable``: it may be left without a place for
    one of higher priority that preempts. ``limits``: of the items that may be beside it.
    """

    name: str
    tasks: tuple[str, ...]
    places: Sequence[int]
    measure: Callable[[int], Shares]
    priority: float = 0.0
    runs: bool = False
    movable: bool = True
    evictable: bool = True
    limits: tuple[OccupancyLimit, ...] = ()


def combine_items(name: str, items: Sequence[Item]) -> Item:
    """One item of tasks that share a place."""
    if len(items) == 1:
        return replace(items[0], name=name)
    first, *rest = items
    return Item(
        name=name,
        tasks=tuple(task for item in items for task in item.tasks),
        places=[place for place in first.places if all(place in item.places for item in rest)],
        measure=lambda place: _add_shares([item.measure(place) for item in items]),
        priority=max(item.priority for item in items),
        runs=any(item.runs for item in items),
        movable=all(item.movable for item in items),
        evictable=all(item.evictable for item in items),
        limits=tuple(limit for item in items for limit in item.limits),
    )


def _add_shares(parts: Sequence[Shares]) -> Shares:
    return {
        column: sum(part.get(column, 0.0) for part in parts)
        for column in dict.fromkeys(column for part in parts for column in part)
    }


@dataclass(slots=True, kw_only=True)
class Packing:
    """Items at their places, and what is free beside them.

    ``work``: looks at one item at one place that are left; the search ends when they are used up. ``tight``:
    fill places up instead of sharing out what is free. ``moves_left``: running items that may leave their
    ``home``; None: any number. ``fixed``: places of what is no item, but counts for limits.
    """

    free: list[list[float]]
    items: dict[str, Item]
    at: dict[str, int]
    home: dict[str, int]
    on: list[list[str]]
    work: int
    moves_left: int | None = None
    tight: bool = False
    fixed: Mapping[str, int] = field(default_factory=dict)
    shares: dict[tuple[str, int], Shares] = field(default_factory=dict)
    chance: int = 1

    def measure(self, item: Item, place: int) -> Shares:
        """The shares of ``item`` at ``place``, computed once."""
        key = item.name, place
        found = self.shares.get(key)
        if found is None:
            found = self.shares[key] = item.measure(place)
        return found

    def put(self, item: Item, place: int) -> None:
        """Charge ``item`` to ``place``."""
        row = self.free[place]
        for column, share in self.measure(item, place).items():
            row[column] -= share
        self.items[item.name] = item
        self.at[item.name] = place
        self.on[place].append(item.name)

    def take(self, item: Item) -> int:
        """Release ``item``; returns the place where it was."""
        place = self.at.pop(item.name)
        row = self.free[place]
        for column, share in self.measure(item, place).items():
            row[column] += share
        self.on[place].remove(item.name)
        return place

    def forget(self, item: Item) -> None:
        """Compute the shares of the items of this name anew."""
        for place in range(len(self.free)):
            self.shares.pop((item.name, place), None)

    def draw(self, below: int) -> int:
        """A number in 0..``below`` - 1: the same series in every run."""
        self.chance = (self.chance * 1103515245 + 12345) % 2**31
        return (self.chance >> 8) % below


@dataclass(frozen=True, slots=True, kw_only=True)
class Permission:
    """Which items may make room for an item of ``priority``."""

    priority: float
    running: bool
    above: bool = False

    def allows(self, item: Item) -> bool:
        """Whether ``item`` may be put elsewhere. No running item gives way to one of lower priority."""
        if not item.movable or (item.runs and not self.running):
            return False
        return item.priority <= self.priority or (self.above and not item.runs)


def place_item(packing: Packing, item: Item) -> bool:
    """Place ``item`` and keep all others placed; False, with everything as it was, where no way is found.

    First where it fits; then with tasks put elsewhere that this plan starts, then also with running ones,
    last also with tasks of higher priority that this plan starts.
    """
    levels = (
        Permission(priority=item.priority, running=False),
        Permission(priority=item.priority, running=True),
        Permission(priority=item.priority, running=True, above=True),
    )
    if _insert(packing, item):
        return True
    if any(_displace_one(packing, item, level) for level in levels):
        return True
    useful = [level for level in levels if _is_new_level(packing, level)]
    work = packing.work
    for packing.tight in (False, True):
        packing.work = work // 2
        if any(_empty_pool(packing, item, level) for level in useful):
            break
    packing.tight = False
    return item.name in packing.at


def preempt_for_item(packing: Packing, item: Item) -> bool:
    """Place ``item`` instead of items of lower priority: of the least, then the fewest.

    They are put elsewhere where they fit, else left without a place.
    """
    best: tuple[tuple[float, int, int], int, list[Item]] | None = None
    for place in item.places:
        for victims in _list_ejections(packing, item, place, _list_victims(packing, item, place)):
            cost = max(v.priority for v in victims), len(victims), sum(v.runs for v in victims)
            if best is None or cost < best[0]:
                best = cost, place, victims
    if best is None:
        return False
    _, place, victims = best
    for victim in victims:
        packing.take(victim)
    packing.put(item, place)
    for victim in sorted(victims, key=lambda victim: -victim.priority):
        if victim.movable and _has_budget(packing, [victim]):
            place_item(packing, victim)
    return True


def _list_victims(packing: Packing, item: Item, place: int) -> list[Item]:
    others = (packing.items[name] for name in packing.on[place])
    return [other for other in others if other.evictable and other.priority < item.priority]


def _is_new_level(packing: Packing, level: Permission) -> bool:
    """Whether ``level`` allows more than the levels before it."""
    items = packing.items.values()
    if level.above:
        return any(not item.runs and item.movable and item.priority > level.priority for item in items)
    return any(level.allows(item) and item.runs == level.running for item in items)


def restore_homes(packing: Packing) -> None:
    """Put items back to their homes where they fit again, running ones first."""
    away = [name for name, home in packing.home.items() if packing.at.get(name, home) != home]
    for name in sorted(away, key=lambda name: not packing.items[name].runs):
        item, home = packing.items[name], packing.home[name]
        place = packing.take(item)
        packing.put(item, home if fits(packing, item, home) else place)


def fits(packing: Packing, item: Item, place: int) -> bool:
    """Whether ``item`` has room at ``place``, and may be beside what is there."""
    packing.work -= 1
    row = packing.free[place]
    for column, share in (packing.shares.get((item.name, place)) or packing.measure(item, place)).items():
        if row[column] - share < -EPSILON:
            return False
    return not item.limits or not _list_conflicts(packing, item, place)


def extend_item(packing: Packing, item: Item) -> bool:
    """Replace the item of the same name by the larger ``item``: at its place if others can make room there,
    else elsewhere if it may leave.
    """
    old, place = packing.items[item.name], packing.at[item.name]
    may_go = may_leave(packing, old)
    packing.take(old)
    packing.forget(item)
    stays = place in item.places and place_item(packing, replace(item, places=(place,)))
    if stays or (may_go and place_item(packing, item)):
        packing.items[item.name] = item
        return True
    packing.forget(item)
    packing.put(old, place)
    return False


def may_leave(packing: Packing, item: Item) -> bool:
    """Whether ``item`` may be put elsewhere than it is."""
    return item.movable and _has_budget(packing, [item])


def keeps_limits(packing: Packing, goals: Mapping[str, int]) -> bool:
    """Whether the items of ``goals`` may be beside those that are with them once all are at their goals."""
    if not any(packing.items[name].limits for name in goals):
        return True
    located = {**packing.fixed, **packing.at, **goals}
    return not any(
        limit.find_excess(name, goal, located)[0] > 0
        for name, goal in goals.items()
        for limit in packing.items[name].limits
    )


def _list_conflicts(packing: Packing, item: Item, place: int) -> list[tuple[int, frozenset[str]]]:
    """How many must leave the domain of ``place`` for ``item``, and of which, for each limit."""
    if not item.limits:
        return []
    located = {**packing.fixed, **packing.at} if packing.fixed else packing.at
    found = (limit.find_excess(item.name, place, located) for limit in item.limits)
    return [(excess, frozenset(there)) for excess, there in found if excess > 0]


def _solves(names: Collection[str], conflicts: Sequence[tuple[int, frozenset[str]]]) -> bool:
    """Whether the items ``names`` are enough to leave."""
    return all(len(there.intersection(names)) >= excess for excess, there in conflicts)


def _insert(packing: Packing, item: Item) -> bool:
    place = _find_place(packing, item)
    if place is not None:
        packing.put(item, place)
    return place is not None


def _find_place(packing: Packing, item: Item, *, besides: int | None = None) -> int | None:
    """Where the most is left (``tight``: the least), of what will be scarcest there; None: nowhere."""
    best, most = None, -inf
    for place in item.places:
        if place != besides and fits(packing, item, place):
            row = packing.free[place]
            left = [row[column] - share for column, share in packing.measure(item, place).items()]
            value = -sum(left) if packing.tight else min(left, default=0.0)
            if value > most:
                best, most = place, value
    return best


def _displace_one(packing: Packing, item: Item, level: Permission) -> bool:
    """Put ``item`` where one other gives way that fits somewhere else at once."""
    for place in item.places:
        if packing.work <= 0:
            return False
        lacking = _find_lacking(packing, item, place)
        conflicts = _list_conflicts(packing, item, place)
        for other in _list_ejectable(packing, place, level):
            if (
                _covers(packing.measure(other, place), lacking)
                and _solves([other.name], conflicts)
                and _has_budget(packing, [other])
                and (goal := _find_place(packing, other, besides=place)) is not None
            ):
                packing.take(other)
                packing.put(other, goal)
                packing.put(item, place)
                return True
    return False


def _find_lacking(packing: Packing, item: Item, place: int) -> Shares:
    """What ``item`` lacks at ``place``, by column."""
    packing.work -= 1
    row = packing.free[place]
    return {
        column: lack
        for column, share in packing.measure(item, place).items()
        if (lack := share - row[column]) > EPSILON
    }


def _covers(released: Shares, lacking: Shares) -> bool:
    """Whether what one item releases is enough."""
    for column, need in lacking.items():  # noqa: SIM110 - a loop: this is half of the search
        if released.get(column, 0.0) < need - EPSILON:
            return False
    return True


def _list_ejectable(packing: Packing, place: int, level: Permission) -> list[Item]:
    return [item for name in packing.on[place] if level.allows(item := packing.items[name])]


def _has_budget(packing: Packing, leaving: Iterable[Item]) -> bool:
    """Whether the running items ``leaving`` may leave their homes, besides those that have."""
    if packing.moves_left is None:
        return True
    gone = {
        name
        for name, home in packing.home.items()
        if packing.items[name].runs and packing.at.get(name) != home
    }
    gone |= {item.name for item in leaving if item.runs}
    return len(gone) <= packing.moves_left


def _empty_pool(packing: Packing, item: Item, level: Permission) -> bool:
    """Insert ``item``, and again and again those that were ejected for it, the hardest to place last."""
    before = dict(packing.at), [row.copy() for row in packing.free], [names.copy() for names in packing.on]
    penalties: dict[str, int] = {}
    pool = [item]
    for _ in range(MAX_STEPS):
        if not pool:
            return True
        if packing.work <= 0:
            break
        current = pool.pop()
        if _insert(packing, current) or _displace_one(packing, current, level):
            continue
        penalties[current.name] = penalties.get(current.name, 1) + 1
        found = _find_ejection(packing, current, level, penalties)
        if found is None:
            break
        place, ejected = found
        for other in ejected:
            packing.take(other)
        packing.put(current, place)
        pool += ejected
        _shake(packing, level)
    if not pool:
        return True
    packing.at, packing.free, packing.on = before
    return False


def _find_ejection(
    packing: Packing, item: Item, level: Permission, penalties: dict[str, int]
) -> tuple[int, list[Item]] | None:
    """The place and the at most three items that give way there with the least sum of penalties."""
    best: tuple[int, int, int, list[Item]] | None = None
    for place in item.places:
        for ejected in _list_ejections(packing, item, place, _list_ejectable(packing, place, level)):
            cost = sum(penalties.get(other.name, 1) for other in ejected)
            if (best is None or cost <= best[0]) and _has_budget(packing, ejected):
                candidate = (cost, packing.draw(1000), place, ejected)
                best = candidate if best is None else min(best, candidate, key=itemgetter(0, 1))
    return _find_large_ejection(packing, item, level, penalties) if best is None else (best[2], best[3])


def _find_large_ejection(
    packing: Packing, item: Item, level: Permission, penalties: dict[str, int]
) -> tuple[int, list[Item]] | None:
    """As ``_find_ejection``, for an item that more must give way to: the least penalised first."""
    best: tuple[int, int, list[Item]] | None = None
    for place in item.places:
        others = _list_ejectable(packing, place, level)
        conflicting = set().union(*(there for _, there in _list_conflicts(packing, item, place)))
        others.sort(key=lambda other: (other.name not in conflicting, penalties.get(other.name, 1)))
        ejected: list[Item] = []
        while others and not fits(packing, item, place):
            ejected.append(others.pop(0))
            packing.take(ejected[-1])
        has_room = fits(packing, item, place)
        for other in ejected:
            packing.put(other, place)
        cost = sum(penalties.get(other.name, 1) for other in ejected)
        if has_room and (best is None or cost < best[0]) and _has_budget(packing, ejected):
            best = cost, place, ejected
    return None if best is None else best[1:]


def _list_ejections(packing: Packing, item: Item, place: int, others: Sequence[Item]) -> Iterator[list[Item]]:
    """The smallest sets of the items ``others`` at ``place`` without which ``item`` fits there."""
    lacking = _find_lacking(packing, item, place)
    conflicts = _list_conflicts(packing, item, place)
    needs = [need - EPSILON for need in lacking.values()]
    gains = []
    for other in others:
        released = packing.measure(other, place)
        gains.append((other, [released.get(column, 0.0) for column in lacking]))
    for count in range(1, MAX_EJECTED + 1):
        some = False
        for chosen in combinations(gains, count):
            packing.work -= 1
            if _cover_together([gain for _, gain in chosen], needs) and (
                not conflicts or _solves([other.name for other, _ in chosen], conflicts)
            ):
                some = True
                yield [other for other, _ in chosen]
        if some:
            return


def _cover_together(released: Sequence[Sequence[float]], needs: Sequence[float]) -> bool:
    """Whether what several items release is enough, by lacking column."""
    for column, need in enumerate(needs):
        total = 0.0
        for gain in released:
            total += gain[column]
        if total < need:
            return False
    return True


def _shake(packing: Packing, level: Permission) -> None:
    """Move a few items that are placed to other places where they fit."""
    names = [
        name
        for name in packing.at
        if level.allows(packing.items[name])
        and not (packing.moves_left is not None and packing.items[name].runs)
    ]
    for _ in range(SHAKES if names else 0):
        item = packing.items[names[packing.draw(len(names))]]
        if len(item.places) < 2:
            continue
        place = item.places[packing.draw(len(item.places))]
        if place == packing.at[item.name] or not fits(packing, item, place):
            continue
        packing.take(item)
        packing.put(item, place)
