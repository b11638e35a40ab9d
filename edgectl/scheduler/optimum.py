# SPDX-License-Identifier: Apache-2.0
"""The best plan by three levels, one after the other (ADR 71): tasks placed, by priority; fewest and cheapest
moves; sum of utilities. Pure: the solver is given.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import ceil, inf

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Certificate
from edgectl.model.policy import Preference
from edgectl.model.task import Task
from edgectl.scheduler.decided_plan import DecidedPlan
from edgectl.scheduler.integer_program import IntegerProgram, Solution, Solver
from edgectl.scheduler.ledger import NO_FREE_SHARE
from edgectl.scheduler.move_cost import HandoffHistory
from edgectl.scheduler.packed_plan import build_search
from edgectl.scheduler.packing import Item, Packing, Shares
from edgectl.scheduler.pattern_program import solve_by_patterns
from edgectl.scheduler.placement_model import (
    bound_alone,
    build_model,
    count_arrivals_apart,
    count_moves,
    count_placed_tasks,
    sum_utilities,
)
from edgectl.scheduler.placement_problem import PlacementItem, PlacementModel, PlacementProblem, Requirements
from edgectl.scheduler.placement_rules import NO_RULES, list_breaches
from edgectl.scheduler.rebalanced_plan import rate_plan
from edgectl.scheduler.slack_links import drop_slack_links
from edgectl.scheduler.stability_rows import Departure, add_stability_rows, list_departures
from edgectl.scheduler.utility import EPSILON

# Settles a plan with these places; returns the moves of the best plan that was settled with as many tasks. It
# need not look for fewer than the given number.
Settler = Callable[[Mapping[str, int], int], float]

# Differences of a sum of utilities below this are rounding.
TOLERANCE = 1e-6
# Shares of the time that is left, for the first two levels and for the third.
_FIRST_SHARE, _LAST_SHARE = 0.5, 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Bounds on all plans: tasks placed, moves, and the sum of utilities with at most ``most_moves``."""

    placed: int
    moves: int
    utility: float | None
    most_moves: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """The best places that were found, and what no plan exceeds.

    ``timed_out``: another run may find other places, and closer bounds.
    """

    places: Mapping[str, int]
    bounds: Bounds
    timed_out: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanValue:
    """The value of a plan, in the order in which plans are compared.

    ``placed``: tasks with a place by priority, the highest first. ``moves``: running tasks that make room.
    """

    placed: tuple[int, ...]
    moves: int
    utility: float

    def is_better_than(self, other: "PlanValue") -> bool:
        """Whether it is better by more than rounding."""
        mine, others = (self.placed, -self.moves), (other.placed, -other.moves)
        return mine > others or (mine == others and self.utility > other.utility + TOLERANCE)


def value_plan(plan: DecidedPlan, plain: DecidedPlan) -> PlanValue:
    """The value of ``plan``; moves are counted from the places of ``plain``, the plan without repair."""
    priorities = sorted({task.priority for task in plan.order}, reverse=True)
    placed = Counter(task.priority for task in plan.order if task.name in plan.placed)
    homes = {name: place for name, (place, _) in plain.placed.items() if name in plain.initial.running}
    moves = sum(name not in plan.placed or plan.placed[name][0] != home for name, home in homes.items())
    return PlanValue(placed=tuple(placed[each] for each in priorities), moves=moves, utility=rate_plan(plan))


def is_overload_kept(plan: DecidedPlan, known: DecidedPlan) -> bool:
    """Whether each place that ``plan`` overloads has no other tasks than in ``known``."""
    here, there = ({(name, place) for name, (place, _) in each.placed.items()} for each in (plan, known))
    rows = [*plan.ledger.free.values(), *plan.ledger.free_links.values()]
    return not any(row[place] < -EPSILON for _, place in here - there for row in rows if place < len(row))


def breaks_no_more_rules(plan: DecidedPlan, known: DecidedPlan) -> bool:
    """Whether each rule between tasks that ``plan`` breaks is broken in ``known`` by the same task there."""
    return list_breaches(plan.context.placement_rules, _locate_all(plan)) <= list_breaches(
        plan.context.placement_rules, _locate_all(known)
    )


def _locate_all(plan: DecidedPlan) -> dict[str, int]:
    """The places of all tasks that count for rules between tasks."""
    return _find_fixed_places(plan) | {name: place for name, (place, _) in plan.placed.items()}


def _find_fixed_places(plan: DecidedPlan) -> dict[str, int]:
    """The places of tasks that the plan does not decide."""
    return {name: place for name, place in plan.initial.located.items() if name not in plan.choices}


def find_optimum(
    problem: PlacementProblem, known: Mapping[str, int], solve: Solver, settle: Settler
) -> Optimum:
    """The best places by all three levels, as far as the solver has the time.

    ``known``: the places of the best plan so far, also of tasks that are no items.
    """
    names = {item.name for item in problem.items}
    places = {name: place for name, place in known.items() if name in names}
    others = {name: place for name, place in known.items() if name not in names}
    late: list[bool] = []

    def solve_level(program: IntegerProgram, share: float) -> Solution:
        solution = solve(program, share)
        late.append(solution.timed_out)
        return solution

    places, placed = _place_by_priority(problem, places, solve_level)
    reached = {priority: low for priority, (low, _) in placed.items()}
    places, moves, least = _reduce_moves(
        problem,
        places,
        Requirements(placed=reached),
        solve_level,
        lambda found, target: settle({**others, **found}, target),
    )
    required = Requirements(placed=reached, most_moves=moves)
    places, utility = _raise_utility(problem, places, required, solve_level)
    most = sum(high for _, high in placed.values())
    bounds = Bounds(placed=most, moves=least, utility=utility, most_moves=moves)
    return Optimum(places=places | others, bounds=bounds, timed_out=any(late))


def certify(found: PlanValue, wanted: int, optimum: Optimum, withheld: int) -> Certificate:
    """The certificate of a plan. ``withheld``: tasks that it leaves out of all figures."""
    bounds = optimum.bounds
    as_many = sum(found.placed) >= len(optimum.places)  # else no bound is of plans that place so few
    bound = bounds.utility if as_many and found.moves <= bounds.most_moves else None
    return Certificate(
        wanted=wanted,
        placed=sum(found.placed),
        placed_bound=max(bounds.placed, sum(found.placed)),
        moves=found.moves,
        moves_bound=min(bounds.moves, found.moves) if as_many else 0,
        utility_sum=found.utility,
        utility_sum_bound=None if bound is None else max(bound, found.utility),
        withheld=withheld,
        timed_out=optimum.timed_out,
    )


def build_problem(
    plain: DecidedPlan, places: Mapping[str, int], left_out: Collection[str] = ()
) -> PlacementProblem:
    """The tasks that ``plain`` places, and those that lack room but for ``left_out``. ``places``: of a known
    plan.

    A running task may move only for one of its priority or more.
    """
    packing, links = build_search(plain)
    tasks = {
        task.name: task for task in plain.order if task.name in packing.items and task.name not in left_out
    }
    wanted = [task.priority for name, task in tasks.items() if name not in packing.at]
    most = max(wanted, default=-inf)
    free = [row.copy() for row in packing.free]
    for name, place in packing.at.items():
        _add_shares(free[place], packing.items[name].shares[place], 1.0)
    limits = [row.copy() for row in free]
    for known in (packing.at, places):
        left = [row.copy() for row in free]
        for name, place in known.items():
            if name not in packing.items:
                continue
            _add_shares(left[place], packing.items[name].shares[place], -1.0)
        for row, mine, others in zip(limits, left, free, strict=True):
            row[:] = [max(a, whole - rest) for a, rest, whole in zip(row, mine, others, strict=True)]
    items = [_build_item(plain, packing, task, links, limits, places, most) for task in tasks.values()]
    return PlacementProblem(
        items=items,
        free=free,
        limits=limits,
        edges=plain.context.fleet.edges,
        weights=plain.context.policy.weights,
        located={name: place for name, place in plain.initial.located.items() if name not in tasks},
        most_handoffs=plain.moves_left,
        rules=plain.context.placement_rules,
        fixed=_find_fixed_places(plain),
        known=(packing.at, places),
        runs=plain.initial.running.keys(),
        move_margin=plain.context.policy.move_margin,
    )


def _add_shares(row: list[float], shares: Shares, sign: float) -> None:
    for column, share in shares.items():
        row[column] += sign * share


def _build_item(
    plain: DecidedPlan,
    packing: Packing,
    task: Task,
    links: Mapping[str, Sequence[int]],
    limits: Sequence[Sequence[float]],
    places: Mapping[str, int],
    most: float,
) -> PlacementItem:
    item = packing.items[task.name]
    home = packing.at.get(task.name) if task.name in plain.initial.running else None
    fixed = home is not None and (not item.movable or task.priority > most)
    known = {place for place in (packing.at.get(task.name), places.get(task.name)) if place is not None}
    allowed = known if fixed else known | set(item.places)
    shares = {
        place: item.shares[place]
        for place in sorted(allowed)
        if place in known or _fits_alone(item.shares[place], limits[place])
    }
    return PlacementItem(
        name=task.name,
        shares=shares,
        priority=task.priority,
        home=home,
        move_cost=_estimate_downtime(plain.context.handoffs, task),
        needs=[need.task for need in task.needs if need.task in packing.items],
        near=[need.task for need in task.needs],
        links=links[task.name],
        voluntary=_list_voluntary_places(plain, task, item, shares, home),
    )


def _list_voluntary_places(
    plain: DecidedPlan, task: Task, item: Item, shares: Mapping[int, Shares], home: int | None
) -> frozenset[int]:
    """The edges for which a running task is certain to leave its home where that gains more than the margin.

    None where anything else may hold it: measured costs of moves, dwell, ``max_moves``, rules between tasks;
    nor where a sum of loads does not say its gain: with predecessors, several links, or ``prefer: pack``.
    """
    context = plain.context
    edges = context.fleet.edges
    if home is None or home >= edges or not item.movable:
        return frozenset()
    if plain.initial.frozen or plain.moves_left is not None or context.placement_rules is not NO_RULES:
        return frozenset()
    known_links = all(robot in plain.ledger.free_links for robot in task.robots)
    packs = context.policy.prefer is Preference.PACK
    if packs or task.needs or len(task.robots) > 1 or not known_links:
        return frozenset()
    if task.name in context.handoffs.downtimes:
        return frozenset()
    return frozenset(place for place in item.places if place in shares and place < edges and place != home)


def _fits_alone(shares: Shares, limits: Sequence[float]) -> bool:
    return all(share <= limits[column] + EPSILON for column, share in shares.items())


def _estimate_downtime(handoffs: HandoffHistory, task: Task) -> float:
    """The price of a move of ``task`` as far as it was measured."""
    known = handoffs.downtimes.get(task.name)
    return max(known.values()) * task.downtime_cost if known else 0.0


def _place_by_priority(
    problem: PlacementProblem, places: Mapping[str, int], solve: Solver
) -> tuple[dict[str, int], dict[float, tuple[int, int]]]:
    """Level 1: the places, and by priority how many tasks have one and how many can at most."""
    counts: dict[float, tuple[int, int]] = {}
    found = dict(places)
    for priority in sorted({item.priority for item in problem.items}, reverse=True):
        names = [item.name for item in problem.items if item.priority == priority]
        low, high = sum(name in found for name in names), len(names)
        if low < high:
            required = {each: count for each, (count, _) in counts.items()}
            count = partial(count_placed_tasks, priority=priority)
            model, solution = _solve_first_level(problem, Requirements(placed=required), count, found, solve)
            high = min(high, int(solution.bound + TOLERANCE)) if abs(solution.bound) < inf else high
            if solution.values is not None:
                other = model.read_places(solution.values)
                if sum(name in other for name in names) > low:
                    found = other
                    low = sum(name in found for name in names)
        counts[priority] = low, max(low, high)
    return found, counts


def _solve_first_level(
    problem: PlacementProblem,
    required: Requirements,
    set_objective: Callable[[PlacementModel], None],
    places: Mapping[str, int],
    solve: Solver,
    departures: Collection[Departure] = (),
) -> tuple[PlacementModel, Solution]:
    """The program of level 1 or 2, as small as it gets (ADR 93), and its solution, begun from ``places``."""
    model = build_model(drop_slack_links(problem), required)
    set_objective(model)
    add_stability_rows(model, problem, departures)
    count_arrivals_apart(model)
    model.start_from(places)
    costs = any(item.move_cost > 0.0 for item in problem.items)
    known = solve_by_patterns(
        model,
        required,
        lambda program: solve(program, _FIRST_SHARE),
        rounded=set_objective is not count_moves or not costs,
    )
    if known is not None and not known.timed_out:
        return model, known
    if known is None:
        return model, solve(model.program, _FIRST_SHARE)
    if known.values is not None:
        model.program.start = dict(enumerate(known.values))
    solution = solve(model.program, _FIRST_SHARE)
    return model, replace(solution, bound=min(solution.bound, known.bound))


def _reduce_moves(
    problem: PlacementProblem,
    known: dict[str, int],
    required: Requirements,
    solve: Solver,
    settle: Settler,
) -> tuple[dict[str, int], int, int]:
    """Level 2: the places, their moves, and how many moves are needed at least.

    Solved again with rows against those that leave by themselves, until a plan stands (ADR 102).
    """
    places, most, least = known, _count_moves(problem, known), 0
    departures: dict[tuple[str, int], Departure] = {}
    while most > least:
        model, solution = _solve_first_level(
            problem, required, count_moves, known, solve, departures.values()
        )
        if abs(solution.bound) < inf:
            least = max(least, ceil(-(solution.bound + model.constant) - 0.5 - TOLERANCE))
        other = None if solution.values is None else model.read_places(solution.values)
        if other is None or _count_moves(problem, other) > most:
            break
        places = other
        if settle(other, least) <= least or solution.timed_out:
            break
        fresh = {(each.item.name, each.place): each for each in list_departures(problem, other)}
        if fresh.keys() <= departures.keys():
            break
        departures |= fresh
    return places, max(_count_moves(problem, places), least), least


def _count_moves(problem: PlacementProblem, places: Mapping[str, int]) -> int:
    return sum(item.home is not None and places.get(item.name) != item.home for item in problem.items)


def _raise_utility(
    problem: PlacementProblem, places: dict[str, int], required: Requirements, solve: Solver
) -> tuple[dict[str, int], float | None]:
    """Level 3: the places, and a bound on the sum of utilities with so many tasks placed and moves."""
    charged = (
        (place, column) for item in problem.items for place, row in item.shares.items() for column in row
    )
    if any(problem.free[place][column] < NO_FREE_SHARE / 2 for place, column in charged):
        return places, None  # a host or link without capacity: its share is no number to add up
    spreading = all(weight >= 0.0 for weight in problem.weights.values())
    if not spreading and any(len(item.links) > 1 for item in problem.items):
        return places, None  # the program counts the first link; the worst may be the better one here
    bound = bound_alone(problem) if spreading else inf  # else other tasks make a host better
    model = build_model(problem, required)
    if not sum_utilities(model):
        return places, _keep_finite(bound)
    model.start_from(places)
    solution = solve(model.program, _LAST_SHARE)
    if solution.values is not None:
        places = model.read_places(solution.values)
    return places, _keep_finite(min(bound, solution.bound))


def _keep_finite(bound: float) -> float | None:
    return bound if abs(bound) < inf else None
