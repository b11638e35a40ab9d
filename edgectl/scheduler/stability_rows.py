# SPDX-License-Identifier: Apache-2.0
"""Rows that leave out plans which running tasks change by themselves when they are settled (ADR 102). Pure.

A running task leaves its home for an edge with room where its total is greater by more than the margin. Each
row says of one task, its home and one such edge: the task is gone, or the edge has no room, or the gain is
within the margin. So every settled plan keeps every row.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from edgectl.model.resource import HOST_RESOURCES, NETWORK
from edgectl.scheduler.ledger import NO_FREE_SHARE
from edgectl.scheduler.placement_problem import Kind, PlacementItem, PlacementModel, PlacementProblem
from edgectl.scheduler.utility import EPSILON

_HOST = tuple(enumerate(HOST_RESOURCES))
# Gains that exceed the margin by less are rounding.
_TOLERANCE = 1e-6


class Departure(NamedTuple):
    """A running task that leaves its home by itself for ``place``."""

    item: PlacementItem
    place: int


def list_departures(problem: PlacementProblem, places: Mapping[str, int]) -> list[Departure]:
    """The tasks that leave their homes by themselves in the plan ``places``, by each better edge."""
    free = [list(row) for row in problem.free]
    for item in problem.items:
        if item.name in places:
            place = places[item.name]
            for column, share in item.shares[place].items():
                free[place][column] -= share
    weighted = [_weigh(problem, row) for row in free[: problem.edges]]
    ranked = sorted(range(problem.edges), key=lambda place: -weighted[place])
    return [
        Departure(item, place)
        for item in problem.items
        if item.voluntary and places.get(item.name) == item.home
        for place in _list_better_places(problem, item, free, weighted, ranked)
    ]


def _weigh(problem: PlacementProblem, row: Sequence[float] | Mapping[int, float]) -> float:
    """The weighted sum of the resources of a host."""
    return sum(problem.weights[each.name] * row[column] for column, each in _HOST)


def _list_better_places(
    problem: PlacementProblem,
    item: PlacementItem,
    free: Sequence[Sequence[float]],
    weighted: Sequence[float],
    ranked: Sequence[int],
) -> Iterable[int]:
    weight, link = problem.weights[NETWORK.name], item.links[0] if item.links else None
    home = item.home or 0
    here = weighted[home] + (weight * free[home][link] if link is not None else weight)
    for place in ranked:
        if weighted[place] + weight - here <= problem.move_margin:
            return
        if place == home or place not in item.voluntary:
            continue
        shares = item.shares[place]
        net = weight * (free[place][link] - shares.get(link, 0.0)) if link is not None else weight
        gain = weighted[place] - _weigh(problem, shares) + net - here
        if gain > problem.move_margin + 2 * _TOLERANCE and all(
            share <= free[place][column] + EPSILON for column, share in shares.items()
        ):
            yield place


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rows:
    """The rows of one program. ``items`` by name, with all links; ``full`` and ``stays``: variables that say
    whether an edge is too full for a kind, and whether tasks stay.
    """

    model: PlacementModel
    problem: PlacementProblem
    items: Mapping[str, PlacementItem]
    full: dict[tuple[int, int, int], int] = field(default_factory=dict)
    stays: dict[tuple[int, int], int] = field(default_factory=dict)
    bounded: set[int] = field(default_factory=set)
    loads: dict[tuple[int, int | None, bool], dict[int, float]] = field(default_factory=dict)


def add_stability_rows(
    model: PlacementModel, problem: PlacementProblem, departures: Iterable[Departure]
) -> None:
    """Rows against ``departures``; ``model``: of ``problem``, perhaps without slack links, with its stays."""
    rows = _Rows(model=model, problem=problem, items={item.name: item for item in problem.items})
    numbers = {item.name: number for number, kind in enumerate(model.kinds) for item in kind.members}
    seen = set()
    for item, place in departures:
        number = numbers[item.name]
        key = number, tuple(item.links), item.home, place
        model.exact = True
        if key not in seen:
            seen.add(key)
            _add_row(rows, number, item, place)


def _add_row(rows: _Rows, number: int, item: PlacementItem, place: int) -> None:
    """The gain less the margin is at most 0, unless the task is gone or a resource of the edge is full."""
    problem, program = rows.problem, rows.model.program
    home, shares = item.home or 0, item.shares[place]
    link = item.links[0] if item.links else None
    if any(problem.limits[place][column] > problem.free[place][column] + EPSILON for column in shares):
        return  # the known plan overloads the edge: what counts as room there is not in the program
    weight = problem.weights[NETWORK.name] if link is not None else 0.0
    start = (
        _weigh(problem, problem.free[place]) - _weigh(problem, shares) - _weigh(problem, problem.free[home])
    )
    most = _weigh(problem, problem.limits[home])
    if link is not None:
        start += weight * (problem.free[place][link] - shares.get(link, 0.0) - problem.free[home][link])
        most += weight * problem.limits[home][link]
    start -= problem.move_margin + _TOLERANCE
    most += start
    if not 0.0 < most < -NO_FREE_SHARE / 2:
        return
    terms = dict(_sum_loads(rows, home, link, most=False))
    for variable, load in _sum_loads(rows, place, link, most=True).items():
        terms[variable] = terms.get(variable, 0.0) - load
    stay = _mark_staying(rows, number, item)
    terms[stay] = terms.get(stay, 0.0) + most
    for full in _mark_full(rows, number, place):
        terms[full] = -most
    program.add_row(terms, upper=most - start)


def _sum_loads(rows: _Rows, place: int, link: int | None, *, most: bool) -> Mapping[int, float]:
    """The weighted load of ``place`` as a task with ``link`` has it, by variable: at most or at least so
    much, because the tasks of a kind may have other links.
    """
    key = place, link, most
    if key not in rows.loads:
        pick = max if most else min
        loads = rows.loads[key] = {}
        for kind in rows.model.kinds:
            if place in kind.at:
                _add_loads(rows, loads, kind, place, link, pick)
    return rows.loads[key]


def _add_loads(
    rows: _Rows,
    loads: dict[int, float],
    kind: Kind,
    place: int,
    link: int | None,
    pick: Callable[[Iterable[float]], float],
) -> None:
    rates = {member.name: _weigh_rate(rows, member.name, place, link) for member in kind.members}
    variable = kind.at[place]
    loads[variable] = _weigh(rows.problem, kind.first.shares[place]) + pick(rates.values())
    stay = kind.stays.get(place, variable)
    if stay != variable:
        at_home = pick(rates[member.name] for member in kind.members if member.home == place)
        loads[stay] = at_home - pick(rates.values())


def _weigh_rate(rows: _Rows, name: str, place: int, link: int | None) -> float:
    """The weighted load of a task on ``link``."""
    item = rows.items[name]
    if link is None or link not in item.shares[place]:
        return 0.0
    return rows.problem.weights[NETWORK.name] * item.shares[place][link]


def _mark_staying(rows: _Rows, number: int, item: PlacementItem) -> int:
    """A variable that is 1 if ``item``, or one of its kind that is like it, stays at home."""
    program, kind, home = rows.model.program, rows.model.kinds[number], item.home or 0
    stay = kind.stays[home]
    count = program.uppers[stay]
    if stay not in rows.bounded and stay != kind.at[home]:
        rows.bounded.add(stay)  # who arrives is none of those that stay, nor of those that left this home
        terms = {each: -1.0 if each == stay else 1.0 for each in kind.stays.values()}
        program.add_row({kind.at[home]: 1.0} | terms, upper=len(kind.members) - count)
    others = sum(not _is_like(rows, item, member) for member in kind.members if member.home == home)
    if count <= 1.0:
        return stay
    if (stay, others) not in rows.stays:
        mark = rows.stays[stay, others] = program.add_variable()
        program.add_row({stay: 1.0, mark: others - count}, upper=float(others))
    return rows.stays[stay, others]


def _is_like(rows: _Rows, item: PlacementItem, member: PlacementItem) -> bool:
    other = rows.items[member.name]
    return tuple(other.links) == tuple(item.links) and set(other.voluntary) == set(item.voluntary)


def _mark_full(rows: _Rows, number: int, place: int) -> list[int]:
    """Variables of which one may be 1 only where a task of the kind has no room at ``place``."""
    program, kinds = rows.model.program, rows.model.kinds
    marks = []
    for column, share in kinds[number].first.shares[place].items():
        key = number, place, column
        if key not in rows.full:
            loads = {
                kind.at[place]: load
                for kind in kinds
                if place in kind.at and (load := kind.first.shares[place].get(column, 0.0)) > 0.0
            }
            enough = rows.problem.free[place][column] - share
            most = sum(load * program.uppers[variable] for variable, load in loads.items())
            mark = rows.full[key] = program.add_variable(upper=float(most >= enough))
            program.add_row({**loads, mark: -enough}, lower=0.0)
        marks.append(rows.full[key])
    return marks
