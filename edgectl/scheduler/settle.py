# SPDX-License-Identifier: Apache-2.0
"""Passes until a plan stands: repetition, groups, room made for tasks, and better plans on request.

Most plans need none of the searches, so each is imported where one is made.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from edgectl.model.assignment import Decision, Verdict
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.decided_plan import DecidedPlan
from edgectl.scheduler.groups import MAX_ROUNDS, withhold_incomplete_groups
from edgectl.scheduler.initial_state import InitialState
from edgectl.scheduler.latency import count_missed_deadlines
from edgectl.scheduler.ledger import compute_demand_usage
from edgectl.scheduler.pass_state import (
    PassResult,
    PlacementPass,
    collect_prior_moves,
    count_moves_left,
    state_from_pass,
)
from edgectl.scheduler.placement_rules import NO_RULES, build_placement_rules
from edgectl.scheduler.single_pass import repeats_at_a_glance, run_pass

# Passes that are tried before a plan counts as one that does not settle (ADR 0010).
MAX_PASSES = 5


class SettledPlan(NamedTuple):
    """A plan, whether its repetition leaves it as it is, and the moves of the passes before it."""

    outcome: PassResult
    settled: bool
    prior_moves: Mapping[str, Choice]


class GroupedPlan(NamedTuple):
    """A plan in which no group is started in part, and ``plain``, the same without room made for tasks.

    ``how``: the pass that makes them, in which the tasks of incomplete groups are withheld.
    """

    how: PlacementPass
    plain: SettledPlan
    found: SettledPlan


def run_with_groups(how: PlacementPass, *, optimal: bool) -> GroupedPlan:
    """A plan in which no group is started in part (ADR 73): made again without each that is incomplete.

    ``optimal``: start from it to look for the best plan.
    """
    plain, found = _run_until_settled(how, optimal=optimal)
    groups = how.context.placement_rules.groups
    for round_ in range(MAX_ROUNDS + len(groups) if groups else 0):
        withheld = find_incomplete_groups(how, found, every=round_ >= MAX_ROUNDS)
        if not withheld:
            break
        how = withhold_tasks(how, withheld)
        plain, found = _run_until_settled(how, optimal=optimal)
    return GroupedPlan(how, plain, found)


def find_incomplete_groups(
    how: PlacementPass, found: SettledPlan, *, every: bool = False
) -> dict[str, Decision]:
    """The decisions that withhold an incomplete group of ``found``; ``every``: all of them."""
    tasks = {task.name: task for task in how.order}
    return withhold_incomplete_groups(
        how.context.placement_rules.groups, tasks, found.outcome.decisions, how.initial.running, every=every
    )


def withhold_tasks(how: PlacementPass, withheld: Mapping[str, Decision]) -> PlacementPass:
    """The pass that takes these decisions as they are."""
    state = replace(how.initial, fixed={**how.initial.fixed, **withheld})
    rules = build_placement_rules(how.order, how.context.fleet, state)
    return replace(how, initial=state, context=replace(how.context, placement_rules=rules))


def _run_until_settled(how: PlacementPass, *, optimal: bool) -> tuple[SettledPlan, SettledPlan]:
    """A plan that its repetition does not change; and it with room made for tasks that found none (ADR 64),
    and with a greater sum of utilities where that is asked for.
    """
    plain = _settle(how, how.initial, {})
    found = _make_room(how, plain)
    if optimal:
        from edgectl.scheduler.rebalanced_plan import rebalance_plan

        known = build_decided_plan(how, found)
        changed = rebalance_plan(known, started_only=True)
        return plain, take_better(how, build_decided_plan(how, plain), found, changed)
    if found.settled and how.context.policy.rebalance:
        found = _rebalance(how, found)
    return plain, found


def _make_room(how: PlacementPass, plain: SettledPlan) -> SettledPlan:
    """The plan with room made for tasks that found none (ADR 64)."""
    if None not in plain.outcome.places.values():
        return plain
    from edgectl.scheduler.repair import repair_plan

    changed = repair_plan(build_decided_plan(how, plain))
    found = _settle_changed(how, plain, changed) if changed else plain
    return found if _keeps_deadlines(how, found, plain) else plain


def _keeps_deadlines(how: PlacementPass, found: SettledPlan, known: SettledPlan) -> bool:
    """Whether no more hard deadlines are missed in ``found`` than in ``known``: a packing knows only room."""
    counts = [
        count_missed_deadlines(how.order, plan.outcome.placed, plan.outcome.ledger) for plan in (found, known)
    ]
    return counts[0] <= counts[1]


def _rebalance(how: PlacementPass, found: SettledPlan) -> SettledPlan:
    """A settled plan with a greater sum of utilities and as many tasks placed, else the same one (ADR 66)."""
    from edgectl.scheduler.rebalanced_plan import rate_plan, rebalance_plan

    before = build_decided_plan(how, found)
    changed = rebalance_plan(before)
    if not changed:
        return found
    other = _settle_changed(how, found, changed)
    gains = rate_plan(build_decided_plan(how, other)) > rate_plan(before)
    gains = gains and _keeps_deadlines(how, other, found)
    placed_before = found.outcome.placed.keys()
    return other if other.settled and gains and other.outcome.placed.keys() >= placed_before else found


def take_better(
    how: PlacementPass, origin: DecidedPlan, best: SettledPlan, changed: Mapping[str, Choice]
) -> SettledPlan:
    """The plan with ``changed``, settled again, if that makes it better, overloads no host anew, and breaks
    no rule between tasks anew.
    """
    if not changed:
        return best
    from edgectl.scheduler.optimum import breaks_no_more_rules, is_overload_kept, value_plan

    other = _settle_changed(how, best, changed)
    plan, known = build_decided_plan(how, other), build_decided_plan(how, best)
    better = other.settled and value_plan(plan, origin).is_better_than(value_plan(known, origin))
    better = better and _keeps_deadlines(how, other, best)
    return other if better and is_overload_kept(plan, known) and breaks_no_more_rules(plan, known) else best


def _settle_changed(how: PlacementPass, plan: SettledPlan, changed: Mapping[str, Choice]) -> SettledPlan:
    other = change_choices(how, plan.outcome, changed)
    moves = collect_prior_moves(other, plan.prior_moves, how.initial)
    return _settle(how, state_from_pass(how.initial, other, how.initial), moves)


def _settle(how: PlacementPass, start: InitialState, prior_moves: Mapping[str, Choice]) -> SettledPlan:
    """The first of five passes that its repetition does not change; else one without voluntary moves.

    The first pass is recorded at once, because most plans stand at once; a later one only when it is known to
    be the one.
    """
    recorded = replace(how, record=True)
    state, moves = start, prior_moves
    outcome = run_pass(recorded, state, moves)
    for _ in range(MAX_PASSES):
        large = how.context.arrays is not None  # on small fleets a look ahead costs what it saves
        if repeats_itself(how, state, outcome) or (large and repeats_at_a_glance(how, state, outcome)):
            last = outcome if state is start else run_pass(recorded, state, moves)
            return SettledPlan(last, settled=True, prior_moves=moves)
        put = collect_prior_moves(outcome, moves, how.initial)
        next_state = state_from_pass(state, outcome, how.initial)
        repeated = run_pass(how, next_state, put)
        if repeated.places == outcome.places:
            last = outcome if state is start else run_pass(recorded, state, moves)
            return SettledPlan(last, settled=True, prior_moves=moves)
        state, moves, outcome = next_state, put, repeated
    last = run_pass(replace(recorded, voluntary=False), start, prior_moves)
    return SettledPlan(last, settled=False, prior_moves=prior_moves)


def repeats_itself(how: PlacementPass, state: InitialState, outcome: PassResult) -> bool:
    """Whether ``outcome`` leaves every task where ``state`` has it: then its repetition is the same pass
    (ADR 134). False says nothing.

    Rules between tasks reserve room, and the paper's own policy charges a task twice: those are repeated.
    """
    if how.rules.strict_paper or how.context.placement_rules is not NO_RULES:
        return False
    running = state.running
    return all(
        choice.place is None
        if (there := running.get(name)) is None
        else choice.verdict is Verdict.KEPT and choice.place == there.place
        for name, choice in outcome.choices.items()
    )


def build_decided_plan(how: PlacementPass, plan: SettledPlan) -> DecidedPlan:
    """What repair, rebalancing and the solver need to know of ``plan``."""
    outcome = plan.outcome
    left = count_moves_left(how, collect_prior_moves(outcome, plan.prior_moves, how.initial))
    return DecidedPlan(
        context=how.context,
        order=how.order,
        initial=how.initial,
        choices=outcome.choices,
        placed=outcome.placed,
        ledger=outcome.ledger,
        moves_left=None if left is None else max(0, left),
    )


def change_choices(how: PlacementPass, outcome: PassResult, changed: Mapping[str, Choice]) -> PassResult:
    """``outcome`` with other choices for some tasks, and gamma in step with them."""
    ledger, placed = outcome.ledger.copy(), dict(outcome.placed)
    for name in changed:
        if name in placed:
            ledger.release(*placed.pop(name))
    for task in how.order:
        choice = changed.get(task.name)
        if choice is not None and choice.place is not None:
            use = compute_demand_usage(ledger.fleet, task, choice.place)
            ledger.charge(choice.place, use)
            placed[task.name] = choice.place, use
    return replace(outcome, choices={**outcome.choices, **changed}, placed=placed, ledger=ledger)


def run_once(how: PlacementPass, initial: InitialState) -> tuple[PassResult, bool]:
    """One pass, and whether its repetition would change it."""
    outcome = run_pass(replace(how, record=True), initial, {})
    return outcome, repeats_itself(how, initial, outcome) or run_pass(
        how, state_from_pass(initial, outcome, initial), collect_prior_moves(outcome, {}, initial)
    ).places == outcome.places
