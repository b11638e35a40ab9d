# SPDX-License-Identifier: Apache-2.0
"""The best plan: solved with all rules, settled as every plan, and taken if it is better (ADR 71, ADR 82).
Pure: the solver is given.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from math import inf

from edgectl.model.assignment import Certificate, Decision, Reason, Verdict
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.decided_plan import DecidedPlan, choose_places, list_wanted
from edgectl.scheduler.integer_program import Solver
from edgectl.scheduler.optimum import build_problem, certify, find_optimum, value_plan
from edgectl.scheduler.pass_state import PlacementPass
from edgectl.scheduler.rebalanced_plan import rebalance_plan
from edgectl.scheduler.settle import (
    GroupedPlan,
    SettledPlan,
    build_decided_plan,
    change_choices,
    find_incomplete_groups,
    take_better,
    withhold_tasks,
)
from edgectl.scheduler.stability_rows import list_departures

# Plans that more tasks leave by themselves are not settled before the solver has looked for another one.
MAX_DEPARTING = 3


def find_best_plan(
    whole: PlacementPass, known: GroupedPlan, solve: Solver
) -> tuple[SettledPlan, Certificate]:
    """The better one of the ``known`` plan and of what the solver finds, and its certificate.

    ``whole``: the pass that withholds no group, so the solver may place those that ``known`` leaves out.
    """
    origin = _return_withheld_tasks(whole, known)
    before = build_decided_plan(known.how, known.found)
    wanted = {task.name for task in list_wanted(origin)}
    left_out = _list_hopeless_members(origin, wanted)
    everything = {name: place for name, (place, _) in before.placed.items()}
    problem = build_problem(origin, everything, left_out)
    best = known.found
    value = value_plan(before, origin)
    improved: set[frozenset[tuple[str, int]]] = set()

    def take(how: PlacementPass, places: Mapping[str, int]) -> None:
        nonlocal best, value
        other = take_better(how, origin, known.found, choose_places(before, places))
        reached = value_plan(build_decided_plan(how, other), origin)
        if reached.is_better_than(value) and not find_incomplete_groups(how, other):
            best, value = other, reached

    def settle(places: Mapping[str, int], target: int) -> float:
        how = withhold_tasks(whole, _withhold_unplaced_groups(whole, known, places))
        for improves in (False, True):
            changed = _improve_newcomers(how, known.found, before, places) if improves else places
            if len({departure.item.name for departure in list_departures(problem, changed)}) <= MAX_DEPARTING:
                take(how, changed)
                improved.update([frozenset(places.items())] if improves else [])
            reached = value.moves if sum(value.placed) >= len(places) else inf
            if reached <= target:
                break
        return reached

    optimum = find_optimum(problem, everything, solve, settle)
    if frozenset(optimum.places.items()) not in improved:
        how = withhold_tasks(whole, _withhold_unplaced_groups(whole, known, optimum.places))
        take(how, _improve_newcomers(how, known.found, before, optimum.places))
    return best, certify(value, len(origin.placed.keys() | wanted - left_out), optimum, len(left_out))


def _improve_newcomers(
    how: PlacementPass, known: SettledPlan, before: DecidedPlan, places: Mapping[str, int]
) -> dict[str, int]:
    """``places`` with those of the tasks that this plan starts improved (ADR 93).

    Where the time was too short for the third level they are as they come, and settling such a plan moves
    running tasks away from them.
    """
    changed = choose_places(before, places)
    if not changed:
        return dict(places)
    outcome = change_choices(how, known.outcome, changed)
    plan = replace(before, choices=outcome.choices, placed=outcome.placed, ledger=outcome.ledger)
    better = rebalance_plan(plan, started_only=True)
    return {**places, **{name: choice.place for name, choice in better.items() if choice.place is not None}}


def _return_withheld_tasks(whole: PlacementPass, known: GroupedPlan) -> DecidedPlan:
    """The plain plan, with the tasks of incomplete groups as tasks that lack room."""
    origin = build_decided_plan(known.how, known.plain)
    fixed = known.how.initial.fixed
    withheld = {name: _describe_lack(fixed[name]) for name in fixed.keys() - whole.initial.fixed.keys()}
    return replace(origin, context=whole.context, choices={**origin.choices, **withheld})


def _describe_lack(decision: Decision) -> Choice:
    reason = Reason.NO_FEASIBLE_HOST if decision.reason is Reason.GROUP else decision.reason
    return Choice(verdict=Verdict.UNPLACED, reason=reason, subject=decision.subject)


def _list_hopeless_members(origin: DecidedPlan, wanted: Collection[str]) -> set[str]:
    """Tasks that cannot start because another one of their group has no place for more than want of room."""
    found: set[str] = set()
    for members in origin.context.placement_rules.groups.values():
        if any(_is_out_of_reach(origin, name, wanted) for name in members):
            found.update(name for name in members if name in wanted and name not in origin.initial.running)
    return found


def _is_out_of_reach(origin: DecidedPlan, name: str, wanted: Collection[str]) -> bool:
    """Whether a task counts as missing in its group, whatever the room."""
    if name in origin.placed or name in wanted:
        return False
    known = origin.choices.get(name) or origin.initial.fixed[name]
    return known.verdict is Verdict.UNPLACED and known.reason is not Reason.PREDECESSOR_INCOMPLETE


def _withhold_unplaced_groups(
    whole: PlacementPass, known: GroupedPlan, places: Mapping[str, int]
) -> dict[str, Decision]:
    """The decisions that withhold the groups of which ``places`` starts no task."""
    told = {decision.task: decision for decision in known.found.outcome.decisions}
    withheld: dict[str, Decision] = {}
    for members in whole.context.placement_rules.groups.values():
        new = [
            name for name in members if name not in whole.initial.fixed and name not in whole.initial.running
        ]
        if len(new) < 2 or any(name in places for name in new):
            continue
        for name in new:
            other = new[1] if name == new[0] else new[0]
            withheld[name] = (
                told[name]
                if told[name].verdict is Verdict.UNPLACED
                else Decision(task=name, verdict=Verdict.UNPLACED, reason=Reason.GROUP, subject=other)
            )
    return withheld
