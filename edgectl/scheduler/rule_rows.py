# SPDX-License-Identifier: Apache-2.0
"""Rules between tasks as rows of integer programs (ADR 82). Pure.

A plan may break a rule with tasks that run. Each row admits what the known plans have, so that no plan that
may be made is excluded and every bound holds.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations

from edgectl.model.assignment import RejectionRule
from edgectl.scheduler.placement_problem import Kind, PlacementModel, PlacementProblem
from edgectl.scheduler.placement_rules import NO_RULES, OccupancyLimit

# A task of a kind at a place.
_Slot = tuple[Kind, int]


def add_rule_rows(model: PlacementModel) -> None:
    """The rows of all rules of the problem."""
    if model.problem.rules is NO_RULES:
        return
    _add_spread_rows(model)
    _add_apart_rows(model)
    for unit in dict.fromkeys(model.problem.rules.units.values()):
        _add_unit_rows(model, unit)
    for members in model.problem.rules.groups.values():
        _add_group_rows(model, members)


def _find_limit(problem: PlacementProblem, name: str, rule: RejectionRule) -> OccupancyLimit | None:
    return next((limit for limit in problem.rules.limits.get(name, ()) if limit.rule is rule), None)


def _add_count_row(model: PlacementModel, slots: Sequence[_Slot], most: int) -> None:
    """At most ``most`` tasks at ``slots``, or as many as a known plan has there."""
    found = [sum(kind.count_at(place, known) for kind, place in slots) for known in model.problem.known]
    upper = max([max(0, most), *found])
    if upper < sum(len(kind.members) for kind, _ in slots):
        model.program.add_row({kind.at[place]: 1.0 for kind, place in slots}, upper=float(upper))


def _add_spread_rows(model: PlacementModel) -> None:
    """No domain has more than its part, less those of the entry that the plan does not decide."""
    spread: dict[frozenset[str], tuple[OccupancyLimit, list[Kind]]] = {}
    for kind in model.kinds:
        limit = _find_limit(model.problem, kind.first.name, RejectionRule.SPREAD)
        if limit is not None:
            spread.setdefault(limit.others, (limit, []))[1].append(kind)
    for limit, kinds in spread.values():
        domains: dict[object, list[_Slot]] = {}
        for kind in kinds:
            for place in kind.at:
                domains.setdefault(limit.domains[place], []).append((kind, place))
        fixed = [limit.domains[place] for name, place in model.problem.fixed.items() if name in limit.others]
        for domain, slots in domains.items():
            _add_count_row(model, slots, limit.most + 1 - fixed.count(domain))


def _add_apart_rows(model: PlacementModel) -> None:
    """Of kinds that are apart at most one has tasks on a host; of a kind that is apart in itself one task."""
    others: dict[Kind, frozenset[str]] = {}
    for kind in model.kinds:
        limit = _find_limit(model.problem, kind.first.name, RejectionRule.APART)
        if limit is not None:
            others[kind] = limit.others
    occupied: dict[_Slot, int] = {}
    for kind, names in others.items():
        taken = {place for name, place in model.problem.fixed.items() if name in names}
        alone = len(kind.members) > 1 and kind.members[1].name in names
        for place in kind.at:
            if place in taken or alone:
                _add_count_row(model, [(kind, place)], 0 if place in taken else 1)
            if alone and not any(kind.count_at(place, known) > 1 for known in model.problem.known):
                occupied[kind, place] = kind.at[place]
    for circle in _list_circles(others):
        for place in dict.fromkeys(place for kind in circle for place in kind.at):
            here = [kind for kind in circle if place in kind.at]
            found = [sum(kind.count_at(place, known) > 0 for kind in here) for known in model.problem.known]
            if max([1, *found]) < len(here):
                terms = {_mark_occupied(model, occupied, (kind, place)): 1.0 for kind in here}
                model.program.add_row(terms, upper=float(max([1, *found])))


def _list_circles(others: Mapping[Kind, frozenset[str]]) -> Iterator[list[Kind]]:
    """Sets of kinds of which each is apart from all others; every pair that is apart is in one of them."""
    covered: set[tuple[Kind, Kind]] = set()
    for first, names in others.items():
        for second in others:
            if first is second or second.first.name not in names or (first, second) in covered:
                continue
            circle = [first, second]
            for kind in others:
                if kind not in circle and all(kind.first.name in others[each] for each in circle):
                    circle.append(kind)
            covered.update(permutations(circle, 2))
            yield circle


def _mark_occupied(model: PlacementModel, occupied: dict[_Slot, int], slot: _Slot) -> int:
    """The variable that is 1 if the kind has a task at the place."""
    kind, place = slot
    if len(kind.members) == 1:
        return kind.at[place]
    if slot not in occupied:
        occupied[slot] = model.program.add_variable()
        terms = {kind.at[place]: 1.0, occupied[slot]: -float(len(kind.members))}
        model.program.add_row(terms, upper=0.0)
    return occupied[slot]


def _add_unit_rows(model: PlacementModel, unit: Sequence[str]) -> None:
    """All tasks of a unit that have a place have the same one. Not of a unit that a known plan divides."""
    kinds = [kind for kind in model.kinds if kind.first.name in unit]
    fixed = {place for name, place in model.problem.fixed.items() if name in unit}
    for known in model.problem.known:
        if len(fixed | {known[name] for name in unit if name in known}) > 1:
            return
    if len(fixed) > 1 or sum(len(kind.members) for kind in kinds) + len(fixed) < 2:
        return
    program = model.program
    chosen = {place: program.add_variable() for place in dict.fromkeys(p for kind in kinds for p in kind.at)}
    program.add_row(dict.fromkeys(chosen.values(), 1.0), upper=1.0)
    for kind in kinds:
        for place, variable in kind.at.items():
            if fixed and place not in fixed:
                program.add_row({variable: 1.0}, upper=0.0)
            else:
                program.add_row({variable: 1.0, chosen[place]: -float(len(kind.members))}, upper=0.0)


def _add_group_rows(model: PlacementModel, members: Sequence[str]) -> None:
    """The tasks of a group that the plan starts have a place all together or not at all; only if those that
    ran keep one.
    """
    kinds = [kind for kind in model.kinds if kind.first.name in members]
    started = [kind for kind in kinds if kind.first.name not in model.problem.runs]
    if not started:
        return
    whole = model.program.add_variable()
    for kind in kinds:
        placed = dict.fromkeys(kind.at.values(), 1.0)
        count = float(len(kind.members))
        if kind in started:
            model.program.add_row(placed | {whole: -count}, lower=0.0, upper=0.0)
        elif kind.first.home is None:
            model.program.add_row(placed | {whole: -count}, lower=0.0)
