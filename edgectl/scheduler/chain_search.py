# SPDX-License-Identifier: Apache-2.0
"""Chains of items of which each goes where the next one was (ADR 85). Pure and deterministic."""

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

from edgectl.scheduler.packing import (
    Item,
    Packing,
    find_place,
    fits,
    has_budget,
    list_conflicts,
    list_sufficient,
    solves,
)

# Items that give way in one chain.
MAX_CHAIN = 9


class _Link(NamedTuple):
    """One item of a chain: it leaves ``place`` to the item at index ``before``; ``left``: all places left so
    far.
    """

    item: Item
    place: int
    before: int
    left: tuple[int, ...]


def shift_chain(packing: Packing, item: Item, movable: Collection[str], longest: int = MAX_CHAIN) -> bool:
    """Put ``item`` where one other gives way, which goes where a further one gives way, and so on until one
    fits somewhere: the shortest such chain, of at most ``longest`` others.
    """
    chain = [_Link(item, -1, -1, ())]
    unasked = {*movable} - {item.name}
    for index, link in enumerate(chain):  # which grows
        if packing.work <= 0 or len(link.left) >= longest:
            return False
        for place, other in _list_giving_way(packing, link, unasked):
            unasked.remove(other.name)
            left = (*link.left, place)
            goal = find_place(packing, other, left)
            if goal is None and len(left) >= longest:
                continue
            step = _Link(other, place, index, left)
            if goal is not None and _shift(packing, chain, step, goal):
                return True
            chain.append(step)
    return False


def _list_giving_way(packing: Packing, link: _Link, unasked: Collection[str]) -> Iterator[tuple[int, Item]]:
    """Items of ``unasked`` of which each alone makes room for the item of ``link`` by leaving, and their
    places.
    """
    item = link.item
    packing.work -= len(item.places)
    for place in item.places:
        if place in link.left:
            continue
        names = [name for name in packing.on[place] if name in unasked]
        if names:
            names = list_sufficient(packing, item, place, names)
        conflicts = list_conflicts(packing, item, place) if names and item.limits else ()
        for name in names:
            if not conflicts or solves([name], conflicts):
                yield place, packing.items[name]


def _shift(packing: Packing, chain: Sequence[_Link], last: _Link, goal: int) -> bool:
    """Put the last item of a chain to ``goal`` and each before it where the next one was; False, with
    everything as it was, where the budget or a limit forbids it.
    """
    steps = [last]
    while steps[-1].before > 0:
        steps.append(chain[steps[-1].before])
    if not has_budget(packing, [step.item for step in steps]):
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
