# SPDX-License-Identifier: Apache-2.0
"""The placement of all tasks of a plan as a problem of counts (ADR 71): what may be put where, and which
tasks are alike. Pure.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.model.policy import Weights
from edgectl.scheduler.integer_program import IntegerProgram
from edgectl.scheduler.packing import Shares
from edgectl.scheduler.placement_rules import NO_RULES, PlacementRules

# Decimal places of shares that tell kinds apart: the share of a task where it runs is computed in another way
# than elsewhere, and differs by rounding.
_KIND_DIGITS = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementItem:
    """One task that the plan places.

    ``shares``: of capacity by column, for each place that may take it. ``home``: where it runs unless it
    makes room; None: this plan starts it, so it may be left unplaced. ``move_cost``: of leaving the home,
    0..1, between plans of equally many moves. ``needs``: tasks that must be placed with it. ``near``: its
    predecessors, for the affinity. ``links``: columns of its links. ``voluntary``: edges for which it leaves
    its home by itself where its total there is greater by more than the margin.
    """

    name: str
    shares: Mapping[int, Shares]
    priority: float = 0.0
    home: int | None = None
    move_cost: float = 0.0
    needs: Sequence[str] = ()
    near: Sequence[str] = ()
    links: Sequence[int] = ()
    voluntary: Collection[int] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementProblem:
    """``free``: free shares by place and column without the items, negative where others overload it; at
    least as much as the present plan takes. ``edges``: places from here on have no links. ``located``: places
    of predecessors that the plan does not decide. ``most_handoffs``: moves that are allowed, where tasks that
    share a host count as one; None: any number.

    ``rules``: between tasks, with ``fixed``, the places of what is no item but counts for them; ``known``,
    plans that may break them; ``runs``, tasks that run before the plan, with a place in it or not.

    ``move_margin``: gain above which tasks move by themselves.
    """

    items: Sequence[PlacementItem]
    free: Sequence[Sequence[float]]
    limits: Sequence[Sequence[float]]
    edges: int
    weights: Weights
    located: Mapping[str, int]
    most_handoffs: int | None = None
    rules: PlacementRules = NO_RULES
    fixed: Mapping[str, int] = field(default_factory=dict)
    known: Sequence[Mapping[str, int]] = ()
    runs: Collection[str] = ()
    move_margin: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirements:
    """What earlier levels have fixed: placed tasks by priority, at least, and moves, at most."""

    placed: Mapping[float, int] = field(default_factory=dict)
    most_moves: int | None = None


@dataclass(eq=False, slots=True, kw_only=True)
class Kind:
    """Tasks that differ in name and home only; ``at``: the variable that counts them, by place; ``stays``:
    the one that counts those of them that are at home there.
    """

    members: list[PlacementItem]
    at: dict[int, int] = field(default_factory=dict)
    stays: dict[int, int] = field(default_factory=dict)

    @property
    def first(self) -> PlacementItem:
        """The member that stands for all."""
        return self.members[0]

    def count_at(self, place: int, places: Mapping[str, int]) -> int:
        """How many members have ``place`` in the plan ``places``."""
        return sum(places.get(item.name) == place for item in self.members)


@dataclass(slots=True, kw_only=True)
class PlacementModel:
    """A program, and what its variables mean.

    ``stays``: variables that count tasks at their homes, with the cost of a move. ``apart``: of variables of
    kinds that leave out the tasks at home, the variable that counts those. ``exact``: a task that does not
    stay has left its home, even if one of its kind has come there.
    """

    problem: PlacementProblem
    program: IntegerProgram
    kinds: list[Kind]
    stays: dict[int, float] = field(default_factory=dict)
    apart: dict[int, int] = field(default_factory=dict)
    constant: float = 0.0
    exact: bool = False

    def read_places(self, values: Sequence[float]) -> dict[str, int]:
        """The place of each placed task in a solution; tasks stay at their homes where they may."""
        places: dict[str, int] = {}
        for kind in self.kinds:
            room = {place: round(self._read_count(values, variable)) for place, variable in kind.at.items()}
            staying = room.copy()
            if self.exact:
                staying |= {place: round(values[stay]) for place, stay in kind.stays.items()}
            away = []
            for item in kind.members:
                if item.home is not None and staying.get(item.home, 0) > 0:
                    places[item.name] = item.home
                    room[item.home] -= 1
                    staying[item.home] -= 1
                else:
                    away.append(item)
            slots = [place for place, count in room.items() for _ in range(count)]
            away.sort(key=lambda item: item.home is None)  # those that run must have a place
            for item in away[: len(slots)]:
                places[item.name] = slots.pop(next((n for n, p in enumerate(slots) if p != item.home), 0))
        return places

    def _read_count(self, values: Sequence[float], variable: int) -> float:
        apart = self.apart.get(variable)
        return values[variable] + (0.0 if apart is None else values[apart])

    def start_from(self, places: Mapping[str, int]) -> None:
        """Let the solver begin with these places."""
        start = self.program.start
        for kind in self.kinds:
            for place, variable in kind.at.items():
                start[variable] = float(kind.count_at(place, places))
            for place, stay in kind.stays.items():
                start[stay] = float(sum(places.get(item.name) == place == item.home for item in kind.members))
                if kind.at[place] in self.apart:
                    start[kind.at[place]] -= start[stay]


def list_kinds(problem: PlacementProblem) -> list[Kind]:
    """The kinds of tasks, each of at least one."""
    related = {name for item in problem.items for name in (*item.needs, *item.near)}
    find_company = _build_company_finder(problem)
    kinds: dict[object, Kind] = {}
    for item in problem.items:
        apart = item.name if item.needs or item.near or item.name in related else None
        shares = tuple(
            (place, tuple((column, round(share, _KIND_DIGITS)) for column, share in row.items()))
            for place, row in item.shares.items()
        )
        key = apart, shares, item.priority, item.move_cost, tuple(item.links), find_company(item.name)
        if key in kinds:
            kinds[key].members.append(item)
        else:
            kinds[key] = Kind(members=[item])
    return list(kinds.values())


def _build_company_finder(problem: PlacementProblem) -> Callable[[str], object]:
    """Tells apart tasks to which rules set different limits: with others, or with each other."""
    rules = problem.rules
    groups = {name: group for group, members in rules.groups.items() for name in members}
    circles = Counter(
        frozenset({item.name, *limit.others})
        for item in problem.items
        for limit in rules.limits.get(item.name, ())
    )

    def find_company(name: str) -> object:
        limits = []
        for limit in rules.limits.get(name, ()):
            circle, others = limit.others | {name}, limit.others - {name}
            closed = circles[circle] > 1
            limits.append((limit.rule, closed, circle if closed else others))
        group = groups.get(name)
        return tuple(limits), rules.units.get(name), group, group is not None and name in problem.runs

    return find_company
