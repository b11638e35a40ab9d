"""Search for a place of one more task among tasks that may make room (ADR 64). Pure and deterministic.

Works on shares of capacity: ``free`` holds one row per place, one column per resource of hosts and per link.
An item fits where no column that it touches falls below 0. All columns of the host are touched, also with a
demand of 0: nothing is added to a host that is overcommitted already.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import cache
from math import comb, inf
from operator import ge, itemgetter, sub
from typing import NamedTuple

from edgectl.dataclass import dataclass
from edgectl.scheduler.placement_rules import OccupancyLimit
from edgectl.scheduler.utility import EPSILON

# Share of the capacity by column.
Shares = Mapping[int, float]
# Tasks that give way to one insertion, and insertions that are tried for one task at each level.
MAX_EJECTED, MAX_STEPS = 3, 400
# Tasks that give way in one chain; in the ejection pool longer ones cost more than they find.
MAX_CHAIN, POOL_CHAIN = 9, 1
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
        return items[0] if items[0].name == name else replace(items[0], name=name)
    first, *rest = items
    return Item(
        name=name,
        tasks=tuple(task for item in items for task in item.tasks),
        places=[place for place in first.places if all(place in item.places for item in rest)],
        measure=cache(lambda place: _add_shares([item.measure(place) for item in items])),
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
    chance: int = 1

    def measure(self, item: Item, place: int) -> Shares:
        """The shares of ``item`` at ``place``."""
        return item.measure(place)

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
    if _insert(packing, item):
        return True
    levels = _list_movable(packing, item)
    if any(_shift_chain(packing, item, movable, longest=1) for movable in levels):
        return True
    if any(_shift_chain(packing, item, movable) for movable in levels):
        return True
    work = packing.work
    for packing.tight in (False, True):
        packing.work = work // 2
        if any(_empty_pool(packing, item, movable) for movable in levels):
            break
    packing.tight = False
    return item.name in packing.at


def _list_movable(packing: Packing, item: Item) -> list[frozenset[str]]:
    """The items that may make room for ``item``, by level; only levels that allow more than those before."""
    levels = (
        Permission(priority=item.priority, running=False),
        Permission(priority=item.priority, running=True),
        Permission(priority=item.priority, running=True, above=True),
    )
    others = [packing.items[name] for name in packing.at]
    found: list[frozenset[str]] = []
    for level in levels:
        names = frozenset(other.name for other in (*others, item) if level.allows(other))
        if len(names) > (len(found[-1]) if found else 0):
            found.append(names)
    return found


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
    for column, share in item.measure(place).items():
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
    stays = place in item.places and place_item(packing, replace(item, places=(place,)))
    if stays or (may_go and place_item(packing, item)):
        packing.items[item.name] = item
        return True
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


def _find_place(packing: Packing, item: Item, besides: Collection[int] = ()) -> int | None:
    """Where the most is left (``tight``: the least), of what will be scarcest there; None: nowhere."""
    best, most = None, -inf
    for place in item.places:
        if place in besides:
            continue
        packing.work -= 1
        row = packing.free[place]
        least, total = inf, 0.0
        for column, share in item.measure(place).items():
            left = row[column] - share
            if left < -EPSILON:
                break
            least = left if left < least else least
            total += left
        else:
            value = -total if packing.tight else least
            if value > most and not _list_conflicts(packing, item, place):
                best, most = place, value
    return best


class _Link(NamedTuple):
    """One item of a chain: it leaves ``place`` to the item at index ``before``; ``left``: all places left so
    far.
    """

    item: Item
    place: int
    before: int
    left: tuple[int, ...]


def _shift_chain(packing: Packing, item: Item, movable: Collection[str], longest: int = MAX_CHAIN) -> bool:
    """Put ``item`` where one other gives way, which goes where a further one gives way, and so on until one
    fits somewhere: the shortest such chain, of at most ``longest`` others.
    """
    chain = [_Link(item, -1, -1, ())]
    seen = {item.name}
    for index, link in enumerate(chain):  # which grows
        if packing.work <= 0 or len(link.left) >= longest:
            return False
        for place in link.item.places:
            if place in link.left:
                continue
            for other in _list_giving_way(packing, link.item, place, movable, seen):
                seen.add(other.name)
                step = _Link(other, place, index, (*link.left, place))
                goal = _find_place(packing, other, step.left)
                if goal is not None and _shift(packing, chain, step, goal):
                    return True
                chain.append(step)
    return False


def _list_giving_way(
    packing: Packing, item: Item, place: int, movable: Collection[str], besides: Collection[str]
) -> Iterator[Item]:
    """Items at ``place`` of which each alone makes room for ``item`` there by leaving."""
    lacking = _find_lacking(packing, item, place)
    conflicts = _list_conflicts(packing, item, place)
    for name in packing.on[place]:
        if name not in movable or name in besides:
            continue
        other = packing.items[name]
        released = other.measure(place)
        for column, need in lacking.items():
            if released.get(column, 0.0) < need - EPSILON:
                break
        else:
            if not conflicts or _solves([name], conflicts):
                yield other


def _shift(packing: Packing, chain: Sequence[_Link], last: _Link, goal: int) -> bool:
    """Put the last item of a chain to ``goal`` and each before it where the next one was; False, with
    everything as it was, where the budget or a limit forbids it.
    """
    steps = [last]
    while steps[-1].before > 0:
        steps.append(chain[steps[-1].before])
    if not _has_budget(packing, [step.item for step in steps]):
        return False
    for done, step in enumerate(steps):
        packing.take(step.item)
        if not fits(packing, step.item, goal):
            packing.put(step.item, step.place)
            for other in reversed(steps[:done]):
                packing.take(other.item)
                packing.put(other.item, other.place)
            return False
        packing.put(step.item, goal)
        goal = step.place
    first = chain[0].item
    if fits(packing, first, goal):
        packing.put(first, goal)
        return True
    for other in reversed(steps):
        packing.take(other.item)
        packing.put(other.item, other.place)
    return False


def _find_lacking(packing: Packing, item: Item, place: int) -> Shares:
    """What ``item`` lacks at ``place``, by column."""
    packing.work -= 1
    row = packing.free[place]
    return {
        column: lack
        for column, share in item.measure(place).items()
        if (lack := share - row[column]) > EPSILON
    }


def _list_movable_at(packing: Packing, place: int, movable: Collection[str]) -> list[Item]:
    return [packing.items[name] for name in packing.on[place] if name in movable]


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


def _empty_pool(packing: Packing, item: Item, movable: Collection[str]) -> bool:
    """Insert ``item``, and again and again those that were ejected for it, the hardest to place last."""
    before = dict(packing.at), [row.copy() for row in packing.free], [names.copy() for names in packing.on]
    shaken = [name for name in packing.at if name in movable and _may_shake(packing, packing.items[name])]
    penalties: dict[str, int] = {}
    pool = [item]
    for _ in range(MAX_STEPS):
        if not pool:
            return True
        if packing.work <= 0:
            break
        current = pool.pop()
        if _insert(packing, current) or _shift_chain(packing, current, movable, longest=POOL_CHAIN):
            continue
        penalties[current.name] = penalties.get(current.name, 1) + 1
        found = _find_ejection(packing, current, movable, penalties)
        if found is None:
            pool.append(current)
            break
        place, ejected = found
        for other in ejected:
            packing.take(other)
        packing.put(current, place)
        pool += ejected
        _shake(packing, shaken)
    if not pool:
        return True
    packing.at, packing.free, packing.on = before
    return False


def _may_shake(packing: Packing, item: Item) -> bool:
    return len(item.places) > 1 and (packing.moves_left is None or not item.runs)


def _find_ejection(
    packing: Packing, item: Item, movable: Collection[str], penalties: Mapping[str, int]
) -> tuple[int, list[Item]] | None:
    """The place and the at most three items that give way there with the least sum of penalties."""
    best: tuple[int, int, int, list[Item]] | None = None
    for place in item.places:
        for ejected in _list_ejections(packing, item, place, _list_movable_at(packing, place, movable)):
            cost = sum([penalties.get(other.name, 1) for other in ejected])
            if (best is None or cost <= best[0]) and _has_budget(packing, ejected):
                candidate = (cost, packing.draw(1000), place, ejected)
                best = candidate if best is None else min(best, candidate, key=itemgetter(0, 1))
    return _find_large_ejection(packing, item, movable, penalties) if best is None else (best[2], best[3])


def _find_large_ejection(
    packing: Packing, item: Item, movable: Collection[str], penalties: Mapping[str, int]
) -> tuple[int, list[Item]] | None:
    """As ``_find_ejection``, for an item that more must give way to: the least penalised first."""
    best: tuple[int, int, list[Item]] | None = None
    for place in item.places:
        others = _list_movable_at(packing, place, movable)
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


def _list_ejections(packing: Packing, item: Item, place: int, others: Sequence[Item]) -> list[list[Item]]:
    """The smallest sets of the items ``others`` at ``place`` without which ``item`` fits there."""
    lacking = _find_lacking(packing, item, place)
    conflicts = _list_conflicts(packing, item, place)
    needs = [need - EPSILON for need in lacking.values()]
    gains = [
        [released.get(column, 0.0) for column in lacking]
        for released in (each.measure(place) for each in others)
    ]
    if any(sum(column) < need for column, need in zip(zip(*gains, strict=True), needs, strict=False)):
        return []
    for count in range(1, MAX_EJECTED + 1):
        found = [[others[index] for index in chosen] for chosen in _list_covers(gains, needs, count)]
        packing.work -= comb(len(others), count)
        if conflicts:
            found = [each for each in found if _solves([other.name for other in each], conflicts)]
        if found:
            return found
    return []


def _list_covers(
    gains: Sequence[Sequence[float]], needs: Sequence[float], count: int, start: int = 0
) -> Iterator[tuple[int, ...]]:
    """Indices of ``count`` rows of ``gains``, from ``start`` on, that add up to ``needs`` in every column."""
    if count == 1:
        for index in range(start, len(gains)):
            if all(map(ge, gains[index], needs)):
                yield (index,)
        return
    for index in range(start, len(gains) - count + 1):
        rest = list(map(sub, needs, gains[index]))
        for others in _list_covers(gains, rest, count - 1, index + 1):
            yield (index, *others)


def _shake(packing: Packing, names: Sequence[str]) -> None:
    """Move a few of the items ``names`` that are placed to other places where they fit."""
    for _ in range(SHAKES if names else 0):
        name = names[packing.draw(len(names))]
        here, item = packing.at.get(name), packing.items[name]
        place = item.places[packing.draw(len(item.places))]
        if here is None or place == here or not fits(packing, item, place):
            continue
        packing.take(item)
        packing.put(item, place)
