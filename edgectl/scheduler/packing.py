# SPDX-License-Identifier: Apache-2.0
"""Items at places, and what is free beside them. Pure and deterministic.

Works on shares of capacity: ``free`` holds one row per place, one column per resource of hosts and per link.
An item fits where no column that it touches falls below 0. All columns of the host are touched, also with a
demand of 0: nothing is added to a host that is overcommitted already.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import field
from math import inf
from typing import NamedTuple

from edgectl.dataclass import dataclass
from edgectl.scheduler.placement_rules import OccupancyLimit
from edgectl.scheduler.utility import EPSILON

# Share of the capacity by column.
Shares = Mapping[int, float]
# The same of all places: by column, a row of one number for each place.
ShareColumns = Sequence[tuple[int, Sequence[float]]]
# What must be left of a column: 0, but for rounding.
_LEAST_LEFT = -EPSILON


class ShareTable(dict[int, Shares]):
    """The shares of a task by place, each measured when it is first read.

    A dict, because a search reads them thousands of times. ``list_columns`` has them by column, without
    columns of which nothing can be lacking; None where they are not known of all places at once.
    """

    __slots__ = ("_columns", "_list_columns", "_measure")

    def __init__(
        self, measure: Callable[[int], Shares], list_columns: Callable[[], ShareColumns | None] | None = None
    ) -> None:
        self._measure = measure
        self._list_columns = list_columns
        self._columns: ShareColumns | None = None

    def __missing__(self, place: int) -> Shares:
        found = self[place] = self._measure(place)
        return found

    @property
    def columns(self) -> ShareColumns | None:
        """What ``list_columns`` gives, asked for once."""
        if self._list_columns is not None:
            self._columns, self._list_columns = self._list_columns(), None
        return self._columns


class Item(NamedTuple):
    """One task of the search, or several that share a place (``tasks``).

    ``places``: those that may take it, in order; ``shares`` at each of them, and at the one where it is.
    ``runs``: its move would be a handoff. ``movable``: it may make room. ``evictable``: it may be left
    without a place for one of higher priority that preempts. ``limits``: of the items that may be beside it.
    """

    name: str
    tasks: tuple[str, ...]
    places: Sequence[int]
    shares: ShareTable
    priority: float = 0.0
    runs: bool = False
    movable: bool = True
    evictable: bool = True
    limits: tuple[OccupancyLimit, ...] = ()


def combine_items(name: str, items: Sequence[Item]) -> Item:
    """One item of tasks that share a place."""
    if len(items) == 1:
        return items[0] if items[0].name == name else items[0]._replace(name=name)
    first, *rest = items
    return Item(
        name=name,
        tasks=tuple(task for item in items for task in item.tasks),
        places=[place for place in first.places if all(place in item.places for item in rest)],
        shares=ShareTable(lambda place: _add_shares([item.shares[place] for item in items])),
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

    ``charged``: the shares of each item at its place. ``work``: looks at one item at one place that are left;
    the search ends when they are used up. ``tight``: fill places up instead of sharing out what is free.
    ``moves_left``: running items that may leave their ``home``; None: any number. ``fixed``: places of what
    is no item, but counts for limits.
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
    charged: dict[str, Shares] = field(init=False)

    def __post_init__(self) -> None:
        self.charged = {name: self.items[name].shares[place] for name, place in self.at.items()}

    def put(self, item: Item, place: int) -> None:
        """Charge ``item`` to ``place``."""
        row, shares = self.free[place], item.shares[place]
        for column, share in shares.items():
            row[column] -= share
        self.items[item.name] = item
        self.at[item.name] = place
        self.charged[item.name] = shares
        self.on[place].append(item.name)

    def take(self, item: Item) -> int:
        """Release ``item``; returns the place where it was."""
        place = self.at.pop(item.name)
        row = self.free[place]
        for column, share in self.charged.pop(item.name).items():
            row[column] += share
        self.on[place].remove(item.name)
        return place

    def draw(self, below: int) -> int:
        """A number in 0..``below`` - 1: the same series in every run."""
        self.chance = (self.chance * 1103515245 + 12345) % 2**31
        return (self.chance >> 8) % below


def find_place(packing: Packing, item: Item, besides: Collection[int] = ()) -> int | None:
    """Where the most is left (``tight``: the least), of what will be scarcest there; None: nowhere."""
    best, most = None, -inf
    for place in _list_roomy_places(packing, item, besides):
        value = _value_place(packing, item, place)
        if value > most and not (item.limits and list_conflicts(packing, item, place)):
            best, most = place, value
    return best


def _list_roomy_places(packing: Packing, item: Item, besides: Collection[int]) -> Sequence[int]:
    """The places of ``item`` where it has room, in order."""
    free, columns = packing.free, item.shares.columns
    places = [place for place in item.places if place not in besides] if besides else item.places
    packing.work -= len(places)
    if columns is None:
        return [place for place in places if _has_room(free[place], item.shares[place])]
    for column, shares in columns:
        places = [place for place in places if free[place][column] - shares[place] >= _LEAST_LEFT]
        if not places:
            break
    return places


def _has_room(row: Sequence[float], shares: Shares) -> bool:
    return all(row[column] - share >= _LEAST_LEFT for column, share in shares.items())


def _value_place(packing: Packing, item: Item, place: int) -> float:
    row, columns = packing.free[place], item.shares.columns
    if columns is not None and not packing.tight:
        return min([row[column] - shares[place] for column, shares in columns])
    left = [row[column] - share for column, share in item.shares[place].items()]
    if not packing.tight:
        return min(left, default=inf)
    total = 0.0
    for each in left:
        total += each
    return -total


def insert_item(packing: Packing, item: Item) -> bool:
    """Put ``item`` where it fits best; False where it fits nowhere."""
    place = find_place(packing, item)
    if place is not None:
        packing.put(item, place)
    return place is not None


def fits(packing: Packing, item: Item, place: int) -> bool:
    """Whether ``item`` has room at ``place``, and may be beside what is there."""
    packing.work -= 1
    row, columns = packing.free[place], item.shares.columns
    if columns is None:
        if not _has_room(row, item.shares[place]):
            return False
    else:
        for column, shares in columns:
            if row[column] - shares[place] < _LEAST_LEFT:
                return False
    return not item.limits or not list_conflicts(packing, item, place)


def list_lacks(packing: Packing, item: Item, place: int) -> list[tuple[int, float]]:
    """The columns in which ``item`` has no room at ``place``, and the least that must be released there."""
    row, columns = packing.free[place], item.shares.columns
    if columns is None:
        pairs = item.shares[place].items()
        return [
            (column, lack - EPSILON) for column, share in pairs if (lack := share - row[column]) > EPSILON
        ]
    return [
        (column, lack - EPSILON)
        for column, shares in columns
        if (lack := shares[place] - row[column]) > EPSILON
    ]


def list_sufficient(packing: Packing, item: Item, place: int, names: list[str]) -> list[str]:
    """Those of ``names``, which are at ``place``, of which each alone makes room there for ``item``."""
    charged, row, columns = packing.charged, packing.free[place], item.shares.columns
    if columns is None:
        for column, need in list_lacks(packing, item, place):
            names = [name for name in names if charged[name].get(column, 0.0) >= need]
        return names
    for column, shares in columns:
        lack = shares[place] - row[column]
        if lack > EPSILON:  # written out, because chains ask it most of all
            need = lack - EPSILON
            names = [name for name in names if charged[name].get(column, 0.0) >= need]
            if not names:
                break
    return names


def list_conflicts(packing: Packing, item: Item, place: int) -> list[tuple[int, frozenset[str]]]:
    """How many must leave the domain of ``place`` for ``item``, and of which, for each limit."""
    if not item.limits:
        return []
    located = {**packing.fixed, **packing.at} if packing.fixed else packing.at
    found = (limit.find_excess(item.name, place, located) for limit in item.limits)
    return [(excess, frozenset(there)) for excess, there in found if excess > 0]


def solves(names: Collection[str], conflicts: Sequence[tuple[int, frozenset[str]]]) -> bool:
    """Whether the items ``names`` are enough to leave."""
    return all(len(there.intersection(names)) >= excess for excess, there in conflicts)


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


def may_leave(packing: Packing, item: Item) -> bool:
    """Whether ``item`` may be put elsewhere than it is."""
    return item.movable and has_budget(packing, [item])


def has_budget(packing: Packing, leaving: Iterable[Item]) -> bool:
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


def restore_homes(packing: Packing) -> None:
    """Put items back to their homes where they fit again, running ones first."""
    away = [name for name, home in packing.home.items() if packing.at.get(name, home) != home]
    for name in sorted(away, key=lambda name: not packing.items[name].runs):
        item, home = packing.items[name], packing.home[name]
        place = packing.take(item)
        packing.put(item, home if fits(packing, item, home) else place)
