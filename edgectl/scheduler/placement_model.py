# SPDX-License-Identifier: Apache-2.0
"""Placement of all tasks of a plan as integer programs (ADR 71). Pure.

A variable counts the tasks of one kind at one place; tasks are of one kind where nothing tells them apart but
their names. Every row is one that each admissible plan satisfies, so that the bounds hold for all of them.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from math import inf

from edgectl.model.resource import AFFINITY, HOST_RESOURCES, NETWORK
from edgectl.scheduler.integer_program import IntegerProgram, Row
from edgectl.scheduler.placement_problem import (
    Kind,
    PlacementItem,
    PlacementModel,
    PlacementProblem,
    Requirements,
    list_kinds,
)
from edgectl.scheduler.rule_rows import add_rule_rows
from edgectl.scheduler.utility import EPSILON

# Above this many variables the sum of utilities is not bounded by a program: of 35 000 not even the linear
# relaxation is solved in 7 s.
MAX_UTILITY_VARIABLES = 30_000


def build_model(problem: PlacementProblem, required: Requirements) -> PlacementModel:
    """The program of all placements that fit and meet ``required``, without an objective.

    Of a priority of which all tasks are required, each kind must be placed whole.
    """
    program = IntegerProgram()
    kinds = list_kinds(problem)
    model = PlacementModel(problem=problem, program=program, kinds=kinds)
    counts = Counter(item.priority for item in problem.items)
    whole = {priority for priority, count in required.placed.items() if count == counts[priority]}
    for kind in kinds:
        kind.at = {place: program.add_variable(upper=float(len(kind.members))) for place in kind.first.shares}
        least = sum(item.home is not None or item.priority in whole for item in kind.members)
        program.add_row(
            dict.fromkeys(kind.at.values(), 1.0), lower=float(least), upper=float(len(kind.members))
        )
    _add_capacity_rows(model)
    _add_need_rows(model)
    add_rule_rows(model)
    for priority, count in required.placed.items():
        if priority not in whole:
            program.add_row(dict.fromkeys(_list_variables(model, priority), 1.0), lower=float(count))
    if required.most_moves is not None:
        running = sum(item.home is not None for item in problem.items)
        _add_stays(model)
        program.add_row(dict.fromkeys(model.stays, 1.0), lower=float(running - required.most_moves))
    if problem.most_handoffs is not None:
        _add_handoff_row(model, problem.most_handoffs)
    return model


def count_placed_tasks(model: PlacementModel, priority: float) -> None:
    """Objective of the first level: as many tasks of one priority as possible.

    Less than a half is for the share of running tasks that stay: it spares the second level a long way.
    """
    for variable in _list_variables(model, priority):
        model.program.gains[variable] = 1.0
    _add_stays(model)
    for variable in model.stays:
        model.program.gains[variable] += 0.5 / (1 + len(model.problem.items))


def count_moves(model: PlacementModel) -> None:
    """Objective of the second level: as few moves as possible, then those of the least cost.

    The objective is minus the count, less a fraction below a half.
    """
    _add_stays(model)
    total = 2.0 * (1.0 + sum(item.move_cost for item in model.problem.items if item.home is not None))
    running = 0
    for kind in model.kinds:
        count = sum(item.home is not None for item in kind.members)
        running += count
        model.constant -= count * (1.0 + kind.first.move_cost / total)
    for variable, cost in model.stays.items():
        model.program.gains[variable] += 1.0 + cost / total


def count_arrivals_apart(model: PlacementModel) -> None:
    """Let the variables of kinds leave out the tasks that stay at home, which have their own.

    The placements are the same; HiGHS proves the fewest moves in half of the time.
    """
    program = model.program
    model.apart = {
        kind.at[place]: stay
        for kind in model.kinds
        for place, stay in kind.stays.items()
        if stay != kind.at[place]
    }
    for variable, stay in model.apart.items():
        program.gains[stay] += program.gains[variable]
    for index, row in enumerate(program.rows):
        terms = dict(zip(row.variables, row.coefficients, strict=True))
        for variable in row.variables:
            if variable in model.apart:
                stay = model.apart[variable]
                terms[stay] = terms.get(stay, 0.0) + terms[variable]
        program.rows[index] = Row(row.lower, row.upper, tuple(terms), tuple(terms.values()))


def sum_utilities(model: PlacementModel) -> bool:
    """Objective of the third level: the sum of eq. (4) over all placed tasks at the final loads.

    False: the program would be too large. The number of tasks at a place multiplies their load, so the
    program chooses this number, and splits the variables by it.
    """
    groups = _list_groups(model)
    if sum(len(members) * most for members, _, most in groups) > MAX_UTILITY_VARIABLES:
        return False
    for members, base, most in groups:
        _add_group(model.program, members, base, most)
    weights = model.problem.weights
    for kind in model.kinds:
        for place, variable in kind.at.items():
            if not _has_links(model.problem, kind.first, place):
                model.program.gains[variable] += weights[NETWORK.name]
        _add_affinity(model, kind)
    return True


def bound_alone(problem: PlacementProblem) -> float:
    """A bound on the sum of utilities: each task at its best place, with no other task there."""
    weights = problem.weights
    total = 0.0
    for item in problem.items:
        best = 0.0 if item.home is None else -inf
        for place, shares in item.shares.items():
            row = problem.free[place]
            value = weights[AFFINITY] * (1.0 if item.near else 0.5)
            for column, resource in enumerate(HOST_RESOURCES):
                value += weights[resource.name] * (row[column] - shares.get(column, 0.0))
            links = item.links if place < problem.edges else ()
            term = min([row[column] - shares.get(column, 0.0) for column in links], default=1.0)
            best = max(best, value + weights[NETWORK.name] * term)
        total += best
    return total


def _list_variables(model: PlacementModel, priority: float) -> list[int]:
    return [
        variable for kind in model.kinds if kind.first.priority == priority for variable in kind.at.values()
    ]


def _add_capacity_rows(model: PlacementModel) -> None:
    limits = model.problem.limits
    for place in range(len(limits)):
        columns: dict[int, dict[int, float]] = {}
        for kind in model.kinds:
            for column, share in kind.first.shares.get(place, {}).items():
                if share > 0.0:
                    columns.setdefault(column, {})[kind.at[place]] = share
        for column, terms in columns.items():
            most = sum(share * model.program.uppers[variable] for variable, share in terms.items())
            if most > limits[place][column]:
                model.program.add_row(terms, upper=max(0.0, limits[place][column]))


def _add_need_rows(model: PlacementModel) -> None:
    """A task that is placed has its predecessors placed."""
    by_name = {kind.first.name: kind for kind in model.kinds}
    for kind in model.kinds:
        for need in kind.first.needs if kind.first.home is None else ():
            if need in by_name:
                terms = dict.fromkeys(kind.at.values(), 1.0)
                model.program.add_row(terms | dict.fromkeys(by_name[need].at.values(), -1.0), upper=0.0)


def _add_stays(model: PlacementModel) -> None:
    """Variables of tasks that stay at home, with their costs of a move: at most as many as are there."""
    if model.stays:
        return
    for kind in model.kinds:
        for place, count in Counter(item.home for item in kind.members if item.home is not None).items():
            variable = kind.at[place]
            if len(kind.members) > 1:
                stay = model.program.add_variable(upper=float(count))
                model.program.add_row({stay: 1.0, variable: -1.0}, upper=0.0)
                variable = stay
            model.stays[variable] = kind.first.move_cost
            kind.stays[place] = variable


def _add_handoff_row(model: PlacementModel, most: int) -> None:
    """At most so many handoffs. Tasks of one unit move as one: those of one kind count for all of them."""
    _add_stays(model)
    seen: set[tuple[str, ...]] = set()
    terms: dict[int, float] = {}
    total = 0
    for kind in model.kinds:
        running = sum(item.home is not None for item in kind.members)
        unit = model.problem.rules.units.get(kind.first.name)
        if not running or unit in seen:
            continue
        if unit is not None:
            seen.add(unit)
        terms |= dict.fromkeys(kind.stays.values(), 1.0 if unit is None else 1.0 / running)
        total += running if unit is None else 1
    model.program.add_row(terms, lower=float(total - most))


def _has_links(problem: PlacementProblem, item: PlacementItem, place: int) -> bool:
    return place < problem.edges and bool(item.links)


# Variable, number of tasks, and load per task, each weighted.
_Member = tuple[int, int, float]


def _list_groups(model: PlacementModel) -> list[tuple[list[_Member], float, int]]:
    """Tasks that share the load of a host, or of a link: members, what is free, and how many fit at most.

    Of several links of a task the first counts: the worst is no better.
    """
    problem, weights = model.problem, model.problem.weights
    groups = []
    for place, row in enumerate(problem.free):
        here = [kind for kind in model.kinds if place in kind.at]
        hosts = [
            (
                kind,
                sum(weights[each.name] * kind.first.shares[place].get(column, 0.0) for column, each in _HOST),
            )
            for kind in here
        ]
        base = sum(weights[each.name] * row[column] for column, each in _HOST)
        groups.append(_build_group(problem, place, hosts, base))
        by_link: dict[int, list[tuple[Kind, float]]] = {}
        for kind in here:
            if _has_links(problem, kind.first, place):
                column = kind.first.links[0]
                rate = weights[NETWORK.name] * kind.first.shares[place].get(column, 0.0)
                by_link.setdefault(column, []).append((kind, rate))
        for column, members in by_link.items():
            groups.append(_build_group(problem, place, members, weights[NETWORK.name] * row[column]))
    return [group for group in groups if group[0]]


_HOST = tuple(enumerate(HOST_RESOURCES))


def _build_group(
    problem: PlacementProblem, place: int, members: Sequence[tuple[Kind, float]], base: float
) -> tuple[list[_Member], float, int]:
    most = _count_most(problem, place, [kind for kind, _ in members])
    return [(kind.at[place], len(kind.members), rate) for kind, rate in members], base, most


def _count_most(problem: PlacementProblem, place: int, kinds: Iterable[Kind]) -> int:
    """How many of the tasks fit at most: the smallest first, by each resource alone."""
    found = [(kind.first.shares[place], len(kind.members)) for kind in kinds]
    most = sum(count for _, count in found)
    for column, _ in _HOST:
        left, fitting = problem.limits[place][column] + EPSILON, 0
        for share, count in sorted((shares.get(column, 0.0), count) for shares, count in found):
            fits = count if share <= 0.0 else min(count, int(max(0.0, left) / share + EPSILON))
            fitting += fits
            left -= fits * share
            if fits < count:
                break
        most = min(most, fitting)
    return most


def _add_group(program: IntegerProgram, members: Sequence[_Member], base: float, most: int) -> None:
    """Add the sum over n tasks of ``base`` less the load of all n, for the n that is chosen."""
    chosen = [program.add_variable() for _ in range(most + 1)]
    program.add_row(dict.fromkeys(chosen, 1.0), lower=1.0, upper=1.0)
    counted: list[dict[int, float]] = [{} for _ in chosen]
    for variable, count, rate in members:
        parts = {}
        for number in range(1, most + 1):
            upper = float(min(count, number))
            part = program.add_variable(base - number * rate, upper, whole=False)
            program.add_row({part: 1.0, chosen[number]: -upper}, upper=0.0)
            parts[part] = 1.0
            counted[number][part] = 1.0
        program.add_row(parts | {variable: -1.0}, lower=0.0, upper=0.0)
    for number in range(1, most + 1):
        program.add_row(counted[number] | {chosen[number]: -float(number)}, lower=0.0, upper=0.0)


def _add_affinity(model: PlacementModel, kind: Kind) -> None:
    """UT_task: 0.5 without predecessors; else at most 1 beside one, and 0 elsewhere."""
    program, weight, item = model.program, model.problem.weights[AFFINITY], kind.first
    by_name = {other.first.name: other for other in model.kinds}
    near = [name for name in item.near if name in by_name or name in model.problem.located]
    if not near or len(kind.at) == 1:
        for variable in kind.at.values():
            program.gains[variable] += 0.5 * weight
        return
    utility = program.add_variable(weight, whole=False)
    placed = dict.fromkeys(kind.at.values(), -1.0)
    program.add_row({utility: 1.0} | placed, upper=0.0)
    beside: dict[int, float] = {}
    reach: list[tuple[dict[int, float], bool]] = []
    for name in near:
        there = by_name[name].at if name in by_name else None
        if there is None:
            place = model.problem.located[name]
            if place in kind.at:
                beside[kind.at[place]] = beside.get(kind.at[place], 0.0) - 1.0
            reach.append(({}, place in kind.at))
            continue
        for place in kind.at.keys() & there.keys():
            both = program.add_variable(whole=False)
            program.add_row({both: 1.0, kind.at[place]: -1.0}, upper=0.0)
            program.add_row({both: 1.0, there[place]: -1.0}, upper=0.0)
            beside[both] = -1.0
        reach.append(({there[place]: 0.5 for place in kind.at.keys() & there.keys()}, False))
    for inside, always in reach:
        program.add_row({utility: 1.0} | beside | inside, upper=0.0 if always else 0.5)
