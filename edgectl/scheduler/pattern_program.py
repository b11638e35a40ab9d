# SPDX-License-Identifier: Apache-2.0
"""The first two levels of the best plan by ways to fill each place, priced as they are needed (ADR 78).

A program that chooses one way for each place has a far closer linear relaxation than one that counts tasks:
no place is filled to its last percent by a part of a task. Its value bounds the objective; the program with
the ways that were priced, solved whole, gives a plan.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import field
from math import inf
from typing import TYPE_CHECKING

from edgectl.dataclass import dataclass
from edgectl.scheduler.integer_program import IntegerProgram, Solution
from edgectl.scheduler.placement_problem import Kind, PlacementModel, Requirements
from edgectl.scheduler.placement_rules import NO_RULES

if TYPE_CHECKING:
    from edgectl.scheduler.array_patterns import PlacePatterns

# Smaller programs are solved at once as they are.
MIN_VARIABLES = 300
# Rounds of pricing; some ten are needed.
MAX_PRICINGS = 60
# Worth of a way, and of the whole, that is rounding.
_TOLERANCE = 1e-6

# Solves one program in its share of the time.
LevelSolver = Callable[[IntegerProgram], Solution]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Column:
    """A variable: its gain, its upper bound, and its coefficients by row. ``place`` and ``counts``: the tasks
    by kind that it puts there; of those that it stands for alone ``stays`` says whether they are at home.
    """

    gain: float
    upper: float
    terms: dict[int, float]
    place: int
    counts: Sequence[int]
    stays: bool | None = None


@dataclass(slots=True, kw_only=True)
class _Master:
    """Rows: one for each kind, one for each listed place, then the capacities of places that are not listed.

    ``placed_gains`` and ``stay_gains``: by kind, of a placed task, and what is added if it stays at home.
    """

    model: PlacementModel
    placed_gains: list[float]
    stay_gains: list[float]
    homes: list[Counter[int]]
    least: list[int]
    patterns: "dict[int, PlacePatterns]"
    rows: dict[int, int] = field(default_factory=dict)
    lowers: list[float] = field(default_factory=list)
    uppers: list[float] = field(default_factory=list)
    columns: list[_Column] = field(default_factory=list)
    seen: set[tuple[int, tuple[int, ...]]] = field(default_factory=set)

    @property
    def kinds(self) -> list[Kind]:
        """The kinds of tasks, in the order of their rows."""
        return self.model.kinds


def solve_by_patterns(
    model: PlacementModel, required: Requirements, solve: LevelSolver, *, rounded: bool
) -> Solution | None:
    """The solution of the program of ``model``, whose start is known, as far as patterns find and bound it.

    ``timed_out`` where it is not proven; ``rounded``: of the objective less than 1 need not be proven. None
    where patterns do not apply: small programs, rules, predecessors, bounded handoffs.
    """
    if len(model.program.gains) < MIN_VARIABLES or not _is_plain(model):
        return None
    master = _build_master(model, required)
    if not master.patterns:
        return None
    known = _value_start(model)
    bound = _price_patterns(master, solve, lambda value: _is_proven(known, value, rounded=rounded))
    if bound is None:
        return None
    if rounded:
        bound = float(int(bound + _TOLERANCE))
    if _is_proven(known, bound, rounded=rounded):
        return Solution(values=_list_start(model), bound=bound)
    solution = solve(_build_program(master, whole=True))
    if solution.values is None:
        return Solution(values=None, bound=bound, timed_out=True)
    values = _read_values(master, solution.values)
    found = sum(gain * value for gain, value in zip(model.program.gains, values, strict=True))
    if found < known - _TOLERANCE:
        return Solution(values=None, bound=bound, timed_out=True)
    return Solution(values=values, bound=bound, timed_out=not _is_proven(found, bound, rounded=rounded))


def _is_plain(model: PlacementModel) -> bool:
    """Whether nothing but capacities and counts limits the tasks."""
    problem = model.problem
    needs = any(kind.first.needs for kind in model.kinds)
    return problem.rules is NO_RULES and problem.most_handoffs is None and not needs and not model.exact


def _is_proven(found: float, bound: float, *, rounded: bool) -> bool:
    return bound < int(found + _TOLERANCE) + 1 - _TOLERANCE if rounded else bound <= found + _TOLERANCE


def _list_start(model: PlacementModel) -> tuple[float, ...]:
    start = model.program.start
    return tuple(start.get(variable, 0.0) for variable in range(len(model.program.gains)))


def _value_start(model: PlacementModel) -> float:
    gains = model.program.gains
    return sum(gains[variable] * value for variable, value in model.program.start.items())


def _build_master(model: PlacementModel, required: Requirements) -> _Master:
    gains, kinds = model.program.gains, model.kinds
    placed_gains = [min(gains[variable] for variable in kind.at.values()) for kind in kinds]
    homes = [Counter(item.home for item in kind.members if item.home is not None) for kind in kinds]
    stay_gains = [
        max([gains[stay] - placed for stay in kind.stays.values()], default=0.0)
        for kind, placed in zip(kinds, placed_gains, strict=True)
    ]
    counts = Counter(item.priority for item in model.problem.items)
    whole = {priority for priority, count in required.placed.items() if count == counts[priority]}
    least = [
        len(kind.members) if kind.first.priority in whole else sum(there.values())
        for kind, there in zip(kinds, homes, strict=True)
    ]
    master = _Master(
        model=model,
        placed_gains=placed_gains,
        stay_gains=stay_gains,
        homes=homes,
        least=least,
        patterns={},
        lowers=[0.0] * len(kinds),
        uppers=[inf] * len(kinds),
    )
    places = sorted({place for kind in kinds for place in kind.at})
    for place in places:
        _add_place(master, place)
    _add_placed_counts(master, required, whole)
    return master


def _add_place(master: _Master, place: int) -> None:
    """The ways to fill ``place``, and the one of the known plan; or, where they are too many, its tasks."""
    from edgectl.scheduler.array_patterns import list_patterns

    limits = master.model.problem.limits[place]
    numbers = [number for number, kind in enumerate(master.kinds) if place in kind.at]
    used = sorted({column for number in numbers for column in _get_shares(master, number, place)})
    shares = [
        [_get_shares(master, number, place).get(column, 0.0) for column in used]
        if place in kind.at
        else [2.0 + abs(limits[column]) for column in used]
        for number, kind in enumerate(master.kinds)
    ]
    most = [len(kind.members) if place in kind.at else 0 for kind in master.kinds]
    homes = [there[place] for there in master.homes]
    found = list_patterns(shares, most, [limits[column] for column in used], homes, master.stay_gains)
    if found is not None:
        master.patterns[place] = found
        master.rows[place] = _add_row(master, -inf, 1.0)
        start = [_count_at_start(master, kind, place) for kind in master.kinds]
        gain = sum(
            min(count, home) * each for count, home, each in zip(start, homes, master.stay_gains, strict=True)
        )
        _add_pattern(master, place, start, gain)
        return
    rows = {column: _add_row(master, -inf, max(0.0, limits[column])) for column in used}
    for number in numbers:
        terms = {number: 1.0} | {
            rows[column]: share for column, share in _get_shares(master, number, place).items() if share > 0.0
        }
        counts = [int(number == each) for each in range(len(master.kinds))]
        for stays, upper in ((True, homes[number]), (False, most[number] - homes[number])):
            if upper:
                gain = master.stay_gains[number] if stays else 0.0
                column_ = _Column(
                    gain=gain, upper=float(upper), terms=terms, place=place, counts=counts, stays=stays
                )
                master.columns.append(column_)


def _get_shares(master: _Master, number: int, place: int) -> dict[int, float]:
    return dict(master.kinds[number].first.shares[place])


def _count_at_start(master: _Master, kind: Kind, place: int) -> int:
    if place not in kind.at:
        return 0
    start, variable = master.model.program.start, kind.at[place]
    apart = master.model.apart.get(variable)
    return round(start.get(variable, 0.0) + (0.0 if apart is None else start.get(apart, 0.0)))


def _add_row(master: _Master, lower: float, upper: float) -> int:
    master.lowers.append(lower)
    master.uppers.append(upper)
    return len(master.lowers) - 1


def _add_pattern(master: _Master, place: int, counts: Sequence[int], gain: float) -> bool:
    """Add the way ``counts`` to fill ``place``; False where it is there already."""
    key = place, tuple(counts)
    if key in master.seen:
        return False
    master.seen.add(key)
    terms = {number: float(count) for number, count in enumerate(counts) if count}
    terms[master.rows[place]] = 1.0
    # Its row bounds it: a bound of its own would have a price of its own, which no new way is told of.
    master.columns.append(_Column(gain=gain, upper=inf, terms=terms, place=place, counts=counts))
    return True


def _add_placed_counts(master: _Master, required: Requirements, whole: set[float]) -> None:
    """A variable for each kind: how many of its tasks count as placed, at most as many as have a place."""
    rows = {
        priority: _add_row(master, float(count), inf)
        for priority, count in required.placed.items()
        if priority not in whole
    }
    nothing = [0] * len(master.kinds)
    for number, kind in enumerate(master.kinds):
        terms = {number: -1.0}
        if kind.first.priority in rows:
            terms[rows[kind.first.priority]] = 1.0
        column = _Column(
            gain=master.placed_gains[number],
            upper=float(len(kind.members)),
            terms=terms | {_add_row(master, float(master.least[number]), inf): 1.0},
            place=-1,
            counts=nothing,
        )
        master.columns.append(column)


def _price_patterns(master: _Master, solve: LevelSolver, is_enough: Callable[[float], bool]) -> float | None:
    """Add ways that pay until none does; the bound on the objective. None: not even a first value is known.

    With the prices of any round each place is worth at most its best way, so every round has a bound.
    """
    best: float | None = None
    for _ in range(MAX_PRICINGS):
        solution = solve(_build_program(master, whole=False))
        if solution.values is None or solution.duals is None or solution.timed_out:
            return best
        prices, bound, added = solution.duals[: len(master.kinds)], solution.bound, False
        for place, patterns in master.patterns.items():
            worth, counts, gain = patterns.find_best(prices)
            excess = worth - solution.duals[master.rows[place]]
            if excess > 0.0:
                bound += excess
            if excess > _TOLERANCE / 10:
                added |= _add_pattern(master, place, counts, gain)
        best = bound if best is None else min(best, bound)
        if not added or is_enough(best):
            break
    return best


def _build_program(master: _Master, *, whole: bool) -> IntegerProgram:
    program = IntegerProgram()
    rows: list[dict[int, float]] = [{} for _ in master.lowers]
    for column in master.columns:
        variable = program.add_variable(column.gain, column.upper, whole=whole)
        for row, coefficient in column.terms.items():
            rows[row][variable] = coefficient
    for terms, lower, upper in zip(rows, master.lowers, master.uppers, strict=True):
        program.add_row(terms, lower=lower, upper=upper)
    return program


def _read_values(master: _Master, values: Sequence[float]) -> tuple[float, ...]:
    """The values of the program of tasks: of each kind no more are placed than there are."""
    stays: Counter[tuple[int, int]] = Counter()
    arrivals: Counter[tuple[int, int]] = Counter()
    for column, value in zip(master.columns, values, strict=True):
        times = round(value)
        if column.place < 0 or not times:
            continue
        for number, count in enumerate(column.counts):
            home = master.homes[number][column.place]
            staying = min(count, home) if column.stays is None else count * column.stays
            stays[number, column.place] += staying * times
            arrivals[number, column.place] += (count - staying) * times
    result = [0.0] * len(master.model.program.gains)
    for number, kind in enumerate(master.kinds):
        placed = sum(stays[number, place] + arrivals[number, place] for place in kind.at)
        surplus = placed - len(kind.members)
        for place, variable in kind.at.items():
            left = max(0, arrivals[number, place] - max(0, surplus))
            surplus -= arrivals[number, place] - left
            stay = kind.stays.get(place, variable)
            result[variable] += float(left)
            result[stay] += float(stays[number, place])
    return tuple(result)
