# SPDX-License-Identifier: Apache-2.0
"""Room for one more item among items that may make room (ADR 64). Pure and deterministic."""

from edgectl.scheduler.chain_search import shift_chain
from edgectl.scheduler.ejection_pool import empty_pool, list_ejections
from edgectl.scheduler.packing import Item, Packing, has_budget, insert_item, may_leave


def place_item(packing: Packing, item: Item) -> bool:
    """Place ``item`` and keep all others placed; False, with everything as it was, where no way is found.

    First where it fits; then with tasks put elsewhere that this plan starts, then also with running ones,
    last also with tasks of higher priority that this plan starts.
    """
    if insert_item(packing, item):
        return True
    levels = _list_movable(packing, item)
    # The shortest chain of the only level is the first that its search finds.
    if len(levels) > 1 and any(shift_chain(packing, item, movable, longest=1) for movable in levels):
        return True
    if any(shift_chain(packing, item, movable) for movable in levels):
        return True
    work = packing.work
    for packing.tight in (False, True):
        packing.work = work // 2
        if any(empty_pool(packing, item, movable) for movable in levels):
            break
    packing.tight = False
    return item.name in packing.at


def _list_movable(packing: Packing, item: Item) -> list[frozenset[str]]:
    """The items that may make room for ``item``, by level; only levels that allow more than those before.

    No running item gives way to one of lower priority.
    """
    others = [other for other in (*map(packing.items.__getitem__, packing.at), item) if other.movable]
    ranked = [other for other in others if other.priority <= item.priority]
    started = [other for other in others if not other.runs]
    levels = (
        frozenset([other.name for other in ranked if not other.runs]),
        frozenset([other.name for other in ranked]),
        frozenset([other.name for other in (*ranked, *started)]),
    )
    found: list[frozenset[str]] = []
    for names in levels:
        if len(names) > (len(found[-1]) if found else 0):
            found.append(names)
    return found


def preempt_for_item(packing: Packing, item: Item) -> bool:
    """Place ``item`` instead of items of lower priority: of the least, then the fewest.

    They are put elsewhere where they fit, else left without a place.
    """
    best: tuple[tuple[float, int, int], int, list[Item]] | None = None
    for place in item.places:
        for victims in list_ejections(packing, item, place, _list_victims(packing, item, place)):
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
        if victim.movable and has_budget(packing, [victim]):
            place_item(packing, victim)
    return True


def _list_victims(packing: Packing, item: Item, place: int) -> list[Item]:
    others = (packing.items[name] for name in packing.on[place])
    return [other for other in others if other.evictable and other.priority < item.priority]


def extend_item(packing: Packing, item: Item) -> bool:
    """Replace the item of the same name by the larger ``item``: at its place if others can make room there,
    else elsewhere if it may leave.
    """
    old, place = packing.items[item.name], packing.at[item.name]
    may_go = may_leave(packing, old)
    packing.take(old)
    stays = place in item.places and place_item(packing, item._replace(places=(place,)))
    if stays or (may_go and place_item(packing, item)):
        packing.items[item.name] = item
        return True
    packing.put(old, place)
    return False
