# SPDX-License-Identifier: Apache-2.0
"""An ejection pool: items are put where others give way, which are inserted again (ADR 64). Pure."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations
from math import comb
from operator import lt

from edgectl.scheduler.chain_search import shift_chain
from edgectl.scheduler.packing import (
    Item,
    Packing,
    fits,
    has_budget,
    insert_item,
    list_conflicts,
    list_lacks,
    solves,
)
from edgectl.scheduler.utility import EPSILON

# Items that give way to one insertion, and insertions that are tried for one item at each level.
MAX_EJECTED, MAX_STEPS = 3, 400
# Items that give way in one chain: here longer ones cost more than they find.
POOL_CHAIN = 1
# Relocations by chance after an ejection: they keep the search from going round in a circle.
SHAKES = 8


def empty_pool(packing: Packing, item: Item, movable: Collection[str]) -> bool:
    """Insert ``item``, which fits nowhere as it is, and again and again those that were ejected for it, the
    hardest to place last.
    """
    before = dict(packing.at), [row.copy() for row in packing.free], [names.copy() for names in packing.on]
    charged = dict(packing.charged)
    shaken = [name for name in packing.at if name in movable and _may_shake(packing, packing.items[name])]
    penalties: dict[str, int] = {}
    pool = [item]
    for step in range(MAX_STEPS):
        if not pool:
            return True
        if packing.work <= 0:
            break
        current = pool.pop()
        if step and _insert(packing, current, movable):
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
    packing.charged = charged
    return False


def _insert(packing: Packing, item: Item, movable: Collection[str]) -> bool:
    return insert_item(packing, item) or shift_chain(packing, item, movable, longest=POOL_CHAIN)


def _may_shake(packing: Packing, item: Item) -> bool:
    return len(item.places) > 1 and (packing.moves_left is None or not item.runs)


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


def _find_ejection(
    packing: Packing, item: Item, movable: Collection[str], penalties: Mapping[str, int]
) -> tuple[int, list[Item]] | None:
    """The place and the at most three items that give way there with the least sum of penalties."""
    best: tuple[int, int, int, list[Item]] | None = None
    most = MAX_EJECTED
    for place in item.places:
        others = [name for name in packing.on[place] if name in movable]
        for names in _list_ejected_names(packing, item, place, others, most):
            cost = sum([penalties.get(name, 1) for name in names])
            if best is not None and cost > best[0]:
                continue
            ejected = [packing.items[name] for name in names]
            if has_budget(packing, ejected):
                drawn = packing.draw(1000)
                if best is None or (cost, drawn) < best[:2]:
                    best, most = (cost, drawn, place, ejected), min(cost, MAX_EJECTED)
    return _find_large_ejection(packing, item, movable, penalties) if best is None else (best[2], best[3])


def _find_large_ejection(
    packing: Packing, item: Item, movable: Collection[str], penalties: Mapping[str, int]
) -> tuple[int, list[Item]] | None:
    """As ``_find_ejection``, for an item that more must give way to: the least penalised first."""
    best: tuple[int, int, list[Item]] | None = None
    for place in item.places:
        others = [packing.items[name] for name in packing.on[place] if name in movable]
        conflicting = set().union(*(there for _, there in list_conflicts(packing, item, place)))
        others.sort(key=lambda other: (other.name not in conflicting, penalties.get(other.name, 1)))
        ejected: list[Item] = []
        while others and not fits(packing, item, place):
            ejected.append(others.pop(0))
            packing.take(ejected[-1])
        has_room = fits(packing, item, place)
        for other in ejected:
            packing.put(other, place)
        cost = sum(penalties.get(other.name, 1) for other in ejected)
        if has_room and (best is None or cost < best[0]) and has_budget(packing, ejected):
            best = cost, place, ejected
    return None if best is None else best[1:]


def list_ejections(packing: Packing, item: Item, place: int, others: Sequence[Item]) -> list[list[Item]]:
    """The smallest sets of the items ``others`` at ``place`` without which ``item`` fits there."""
    found = _list_ejected_names(packing, item, place, [other.name for other in others], MAX_EJECTED)
    return [[packing.items[name] for name in names] for names in found]


def _list_ejected_names(
    packing: Packing, item: Item, place: int, others: Sequence[str], most: int
) -> Sequence[Sequence[str]]:
    """The smallest sets of the items ``others`` at ``place`` without which ``item`` fits there; none if they
    are of more than ``most`` items.
    """
    packing.work -= 1
    lacks = list_lacks(packing, item, place)
    conflicts = list_conflicts(packing, item, place) if item.limits else ()
    gains = [[packing.charged[name].get(column, 0.0) for name in others] for column, _ in lacks]
    needs = [need for _, need in lacks]
    if any(map(lt, map(sum, gains), needs)):
        return []
    for count in range(1, most + 1):
        packing.work -= comb(len(others), count)
        covers: Iterable[Sequence[str]] = _list_covers(others, gains, needs, count)
        if conflicts:
            covers = [names for names in covers if solves(names, conflicts)]
        found = list(covers)
        if found:
            return found
    return []


def _list_covers(
    names: Sequence[str], gains: Sequence[Sequence[float]], needs: Sequence[float], count: int
) -> list[list[str]]:
    """All ``count`` of ``names`` whose ``gains``, by column, add up to ``needs``."""
    columns = list(zip(gains, needs, strict=True))
    if count == 1:
        enough: Sequence[int] = range(len(names))
        for gain, need in columns:
            enough = [index for index in enough if gain[index] >= need]
        return [[names[index]] for index in enough]
    if any(sum(sorted(column)[-count:]) < need - EPSILON for column, need in columns):
        return []  # not even the greatest
    found = []
    for chosen in combinations(range(len(names)), count):
        for column, need in columns:
            rest = need
            for index in chosen[:-1]:
                rest -= column[index]
            if column[chosen[-1]] < rest:
                break
        else:
            found.append([names[index] for index in chosen])
    return found
