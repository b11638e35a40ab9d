# SPDX-License-Identifier: Apache-2.0
"""Relocations and swaps that raise the sum of utilities of a whole plan (ADR 66). Pure and deterministic."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from edgectl.model.resource import HOST_RESOURCES
from edgectl.scheduler.packing import Packing
from edgectl.scheduler.utility import EPSILON
from edgectl.scheduler.utility_sum import (
    Goals,
    Objective,
    UtilitySum,
    build_utility_sum,
    count_leaving,
    fits_goals,
    move_items,
    weigh_goals,
    weigh_links,
    weigh_relocations,
)

# Relocations and swaps that are weighed: some 0.2 s.
MAX_TRIALS = 24_000
# Pairs of an item and a place that are measured.
MAX_PAIRS = 50_000
# What links are taken to add to a swap at most: others are not weighed to the end.
SMALL_LINK_GAIN = 0.02
# Disturbed plans in a row that lead to nothing better, after which the search ends; items that one disturbs,
# and those that give way to one of them.
MAX_VAIN, KICKED, MAX_YIELDING = 40, 4, 4


@dataclass(slots=True, kw_only=True)
class _Search:
    """``names``: items that may be moved. ``left``: trials."""

    sum: UtilitySum
    names: Sequence[str]
    left: int = MAX_TRIALS


def rebalance_packing(packing: Packing, objective: Objective, margin: float) -> None:
    """Relocate and swap items until nothing gains, then again from disturbed plans, and keep the best.

    Each running item that leaves its home must gain more than ``margin`` to the sum.
    """
    ordered = sorted(packing.at, key=lambda name: _get_sort_key(packing, name))
    ranks = {name: rank for rank, name in enumerate(ordered)}
    for there in packing.on:
        there.sort(key=ranks.__getitem__)
    names = [name for name in ordered if packing.items[name].movable]
    if len(names) * len(packing.free) > MAX_PAIRS:
        names = names[: max(1, MAX_PAIRS // len(packing.free))]
    total = build_utility_sum(packing, objective, margin, names)
    search = _Search(sum=total, names=names)
    _climb(search)
    best, at, vain = total.value, dict(packing.at), 0
    while names and search.left > 0 and vain < MAX_VAIN:
        for _ in range(KICKED):
            _kick(search)
        _climb(search)
        if total.value > best + EPSILON:
            best, at, vain = total.value, dict(packing.at), 0
        else:
            _restore(search, at, best)
            vain += 1
    _restore(search, at, best)


def _get_sort_key(packing: Packing, name: str) -> tuple[object, ...]:
    """Large items first; names are irrelevant as far as the items or their places differ."""
    item, place = packing.items[name], packing.at[name]
    shares, free = item.shares[place], packing.free[place]
    host = [-shares.get(column, 0.0) for column in range(len(HOST_RESOURCES))]
    links = sorted((-share, free[column]) for column, share in shares.items() if column >= len(host))
    return -item.priority, host, links, free[: len(host)], name


def _restore(search: _Search, at: Goals, value: float) -> None:
    there = search.sum.packing.at
    move_items(search.sum, {name: at[name] for name in search.names if there[name] != at[name]})
    search.sum.value = value


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
    packing, part = search.sum.packing, search.sum.parts[name]
    here = packing.at[name]
    search.left -= len(part.item.places)
    if part.alone:
        return any(
            _take_gain(search.sum, {name: place}, gain) for place, gain in weigh_relocations(search.sum, name)
        )
    return any(place != here and _try(search.sum, {name: place}, EPSILON) for place in part.item.places)


def _swap(search: _Search, name: str, others: Sequence[str]) -> bool:
    """Swap one item with the first of ``others`` where that gains."""
    packing, parts = search.sum.packing, search.sum.parts
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
            if _may_swap(packing, name, other) and _try(search.sum, {name: there, other: here}, EPSILON):
                return True
            continue
        gain = count * (rate - theirs.rates[here]) + len(on[there]) * (theirs.rates[there] - rates[there])
        if gain > -SMALL_LINK_GAIN:
            gain += weigh_links(search.sum, {name: there, other: here})
            if gain > EPSILON and _take_gain(search.sum, {name: there, other: here}, gain):
                return True
    return False


def _may_swap(packing: Packing, name: str, other: str) -> bool:
    return packing.at[other] in packing.items[name].places and packing.at[name] in packing.items[other].places


def _take_gain(total: UtilitySum, goals: Goals, gain: float) -> bool:
    """Move items for ``gain`` if that is worth it for running ones too, and they fit."""
    gain -= total.margin * count_leaving(total.packing, goals)
    if gain <= EPSILON or not fits_goals(total.packing, goals):
        return False
    move_items(total, goals)
    total.value += gain
    return True


def _try(total: UtilitySum, goals: Goals, needed: float) -> bool:
    """Put items to their ``goals`` if they fit there and the sum gains more than ``needed``."""
    if not fits_goals(total.packing, goals):
        return False
    gain = weigh_goals(total, goals)
    if gain <= needed:
        return False
    move_items(total, goals)
    total.value += gain
    return True


def _kick(search: _Search) -> None:
    """Move one item drawn by lot to a place drawn by lot, whatever it costs.

    Where it lacks room others, drawn by lot too, take its place: several small ones for a large one, too.
    """
    packing = search.sum.packing
    name = search.names[packing.draw(len(search.names))]
    here, places = packing.at[name], packing.items[name].places
    place = places[packing.draw(len(places))] if places else here
    if place == here:
        return
    others = [
        other
        for other in packing.on[place]
        if packing.items[other].movable and other in search.sum.parts and here in packing.items[other].places
    ]
    goals = {name: place}
    while not _try(search.sum, goals, -inf) and others and len(goals) <= MAX_YIELDING:
        goals[others.pop(packing.draw(len(others)))] = here
