# SPDX-License-Identifier: Apache-2.0
"""A proof that nobody can make room for an item: all ways to put others elsewhere are looked at (ADR 167).

Pure. Of few items there are few ways, and a search that looks for one by chance takes a hundred times as long
to give up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from edgectl.scheduler.packing import Item, Packing

# Items that may make room, and looks at one of them at one place, from which on nothing is certain.
MAX_ITEMS, MAX_LOOKS = 12, 2000
# Sums of shares in another order differ by less.
_TOLERANCE = 1e-6


@dataclass(slots=True, kw_only=True)
class _Ways:
    """The ways that are left. ``free``: rows without what may be put elsewhere; ``entered``: by place, the
    columns of those that came there, in which nothing may be lacking. ``away``: running items that may
    still be elsewhere than at home; None: any number.
    """

    packing: Packing
    free: list[list[float]]
    entered: list[set[int]]
    away: int | None
    looks: int = MAX_LOOKS


def is_dead_end(packing: Packing, item: Item) -> bool:
    """Whether ``item``, which has no place, finds none wherever others are put that may make room for it.

    False where that is not certain: of many items, or where only a rule between items stands against it.
    """
    others = [packing.items[name] for name in packing.at]
    # As the most that an insertion permits: no running item gives way to one of lower priority.
    movable = [each for each in others if each.movable and (each.priority <= item.priority or not each.runs)]
    if len(movable) > MAX_ITEMS:
        return False
    free = [row.copy() for row in packing.free]
    for each in movable:
        row = free[packing.at[each.name]]
        for column, share in packing.charged[each.name].items():
            row[column] += share
    movable.sort(key=lambda each: -max(packing.charged[each.name].values(), default=0.0))
    ways = _Ways(
        packing=packing,
        free=free,
        entered=[set() for _ in free],
        away=_count_away(packing, others, movable),
    )
    return not _can_place(ways, [item, *movable], 0)


def _count_away(packing: Packing, others: Sequence[Item], movable: Sequence[Item]) -> int | None:
    """How many of the running items ``movable`` may be away from home at most."""
    if packing.moves_left is None:
        return None
    gone = {
        each.name for each in others if each.runs and packing.at[each.name] != packing.home.get(each.name)
    }
    return max(packing.moves_left, len(gone)) - len(gone - {each.name for each in movable})


def _can_place(ways: _Ways, items: Sequence[Item], index: int) -> bool:
    """Whether the items from ``index`` on all have room; True as well where too many looks were made."""
    if index == len(items):
        return True
    item = items[index]
    at = ways.packing.at.get(item.name)
    places = [place for place in item.places if place != at]
    return any(_can_put(ways, items, index, place) for place in ([*places] if at is None else [at, *places]))


def _can_put(ways: _Ways, items: Sequence[Item], index: int, place: int) -> bool:
    """Whether the item at ``index`` has room at ``place`` with all that follow at some places."""
    ways.looks -= 1
    if ways.looks <= 0:
        return True
    item, row, before, away = items[index], ways.free[place], ways.entered[place], ways.away
    stays = place == ways.packing.at.get(item.name)
    shares = ways.packing.charged[item.name] if stays else item.shares[place]
    if not stays:
        ways.entered[place] = before.union(shares)
    if away is not None and item.runs and place != ways.packing.home.get(item.name):
        ways.away = away - 1
    for column, share in shares.items():
        row[column] -= share
    found = (
        (ways.away is None or ways.away >= 0)
        and all(row[column] >= -_TOLERANCE for column in ways.entered[place])
        and _can_place(ways, items, index + 1)
    )
    for column, share in shares.items():
        row[column] += share
    ways.entered[place], ways.away = before, away
    return found
