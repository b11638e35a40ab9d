# SPDX-License-Identifier: Apache-2.0
"""The fewest moves of plans that stand: no placement of a small fleet that stands has fewer (ADR 102)."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from math import inf
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.model.policy import Weights
from edgectl.model.resource import HOST_RESOURCES, NETWORK
from edgectl.scheduler.optimum import Optimum, find_optimum
from edgectl.scheduler.placement_problem import PlacementItem, PlacementProblem
from edgectl.scheduler.stability_rows import list_departures
from edgectl.solver.highs import make_solver

EDGES, MARGIN = 3, 0.05
WEIGHTS = Weights().normalised()
# The columns of links come after those of hosts, of which the tasks use the first two.
LINKS = (len(HOST_RESOURCES), len(HOST_RESOURCES) + 1)
UNUSED = range(2, len(HOST_RESOURCES))

few = settings(max_examples=max(15, settings().max_examples // 2), deadline=None)


def draw_problem(seed: int, links: int) -> PlacementProblem:
    """Four running tasks and two new ones on three edges, of three kinds, whose tasks have one of ``links``."""
    dice = Random(seed)
    free = [[dice.uniform(0.5, 1.0) for _ in range(4)] for _ in range(EDGES)]
    for row in free:
        row[2:2] = [1.0] * len(UNUSED)
    kinds = [
        [[dice.uniform(0.05, 0.4), dice.uniform(0.05, 0.4), dice.uniform(0.0, 0.3)] for _ in range(EDGES)]
        for _ in range(3)
    ]
    items = []
    for number in range(6):
        kind, link = dice.choice(kinds), dice.choice(LINKS[:links])
        home = dice.randrange(EDGES) if number < 4 else None
        items.append(
            PlacementItem(
                name=f"task{number}",
                shares={
                    place: {0: cpu, 1: ram, **dict.fromkeys(UNUSED, 0.0), link: rate}
                    for place, (cpu, ram, rate) in enumerate(kind)
                },
                home=home,
                links=[link],
                voluntary=frozenset(range(EDGES)) - {home} if home is not None else (),
            )
        )
    return PlacementProblem(
        items=items, free=free, limits=free, edges=EDGES, weights=WEIGHTS, located={}, move_margin=MARGIN
    )


def list_loads(problem: PlacementProblem, places: Mapping[str, int]) -> list[list[float]]:
    """What is free by place and column in the plan ``places``."""
    free = [list(row) for row in problem.free]
    for item in problem.items:
        for column, share in item.shares[places[item.name]].items():
            free[places[item.name]][column] -= share
    return free


def stands(problem: PlacementProblem, places: Mapping[str, int]) -> bool:
    """Whether no task at home gains more than the margin by leaving, by eq. (4)."""
    for item in problem.items:
        here = places[item.name]
        if item.home != here:
            continue
        now = rate(list_loads(problem, places)[here], item)
        for other in range(EDGES):
            row = list_loads(problem, {**places, item.name: other})[other]
            if other != here and min(row) >= 0.0 and rate(row, item) - now > MARGIN:
                return False
    return True


def rate(row: list[float], item: PlacementItem) -> float:
    hosts = sum(WEIGHTS[each.name] * row[column] for column, each in enumerate(HOST_RESOURCES))
    return hosts + WEIGHTS[NETWORK.name] * row[item.links[0]]


def count_moves(problem: PlacementProblem, places: Mapping[str, int]) -> int:
    return sum(item.home not in (None, places[item.name]) for item in problem.items)


def list_placements(problem: PlacementProblem) -> Iterator[dict[str, int]]:
    """All placements of all tasks that fit."""
    for chosen in product(range(EDGES), repeat=len(problem.items)):
        places = {item.name: place for item, place in zip(problem.items, chosen, strict=True)}
        if min(map(min, list_loads(problem, places))) >= 0.0:
            yield places


def optimise(problem: PlacementProblem, known: dict[str, int]) -> tuple[Optimum, float]:
    """The optimum from the ``known`` plan, and the moves of the best plan that stands."""
    best: float = count_moves(problem, known)

    def settle(places: Mapping[str, int], target: int) -> float:
        nonlocal best
        if stands(problem, places):
            best = min(best, count_moves(problem, places))
        return best

    return find_optimum(problem, known, make_solver(inf), settle), best


@few
@given(st.integers(0, 10_000), st.integers(1, 2))
def test_no_placement_that_stands_has_fewer_moves_than_the_bound(seed: int, links: int) -> None:
    problem = draw_problem(seed, links)
    standing = [places for places in list_placements(problem) if stands(problem, places)]
    if not standing:
        return
    least = min(count_moves(problem, places) for places in standing)
    known = max(standing, key=lambda places: count_moves(problem, places))
    optimum, found = optimise(problem, known)
    assert optimum.bounds.moves <= least
    if links == 1:  # then the rows are exact
        assert optimum.bounds.moves == least == found


@pytest.mark.parametrize(("seed", "fewest", "standing"), [(20, 0, 1), (32, 0, 1), (42, 0, 1), (64, 1, 2)])
def test_rows_raise_the_bound_where_the_fewest_moves_do_not_stand(
    seed: int, fewest: int, standing: int
) -> None:
    """Seeds 32 and 42: a task must not leave its home for its home, or for one of its kind that stays."""
    problem = draw_problem(seed, 1)
    placements = list(list_placements(problem))
    assert min(count_moves(problem, places) for places in placements) == fewest
    known = max(
        (places for places in placements if stands(problem, places)),
        key=lambda places: count_moves(problem, places),
    )
    optimum, found = optimise(problem, known)
    assert (optimum.bounds.moves, found) == (standing, standing)


def test_the_tasks_that_leave_are_those_of_which_eq_4_says_so() -> None:
    for seed in range(20):
        problem = draw_problem(seed, 2)
        for places in list(list_placements(problem))[::7]:
            assert (not list_departures(problem, places)) == stands(problem, places)


def test_a_task_that_something_may_hold_has_no_rows() -> None:
    problem = draw_problem(0, 2)
    held = replace(problem, items=[replace(item, voluntary=()) for item in problem.items])
    assert not any(list_departures(held, places) for places in list_placements(held))
    assert any(list_departures(problem, places) for places in list_placements(problem))
