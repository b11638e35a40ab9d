# SPDX-License-Identifier: Apache-2.0
"""Choice of a host: eq. (5) with its ties, and handoff avoidance."""

from dataclasses import replace

from edgectl.dataclass import dataclass
from edgectl.model.assignment import MoveCost, Reason, RejectionRule, Verdict
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.task import NothingFits
from edgectl.scheduler.candidates import CandidateSet, find_excess, latency_at, resource_terms_at
from edgectl.scheduler.latency import rate_predicted_latency
from edgectl.scheduler.ledger import NO_FREE_SHARE
from edgectl.scheduler.move_cost import estimate_move_cost
from edgectl.scheduler.scan import compute_worst_terms, is_feasible_total
from edgectl.scheduler.ties import choose_tied_place
from edgectl.scheduler.utility import EPSILON


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """Choice of one pass for one task.

    ``place`` is None where it is unplaced; ``voluntary``: a move that nothing forced. ``counted``: a move
    that ``max_moves`` counts, because nothing forced it, or only a shortage of what a task can go without.
    """

    verdict: Verdict
    reason: Reason
    place: int | None = None
    amount: float | None = None
    cost: MoveCost | None = None
    nearest: int | None = None
    subject: str | None = None
    voluntary: bool = False
    counted: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveConstraints:
    """Constraints that keep a running task in place.

    ``dwell_s``: seconds it has been there, None where this plan put it there. ``moves_left``: voluntary moves
    still allowed, None = any. ``voluntary``: whether such moves are allowed at all in this pass. ``follows``:
    the tasks that share its host have left it in this plan; ``in_unit``: there are such tasks.
    """

    frozen: bool = False
    voluntary: bool = True
    dwell_s: float | None = None
    moves_left: int | None = None
    follows: bool = False
    in_unit: bool = False


# Rules between tasks: who breaks one has a place all the same, and is in no hurry to leave it.
_RULES_BETWEEN_TASKS = (RejectionRule.APART, RejectionRule.TOGETHER, RejectionRule.SPREAD)


def find_best_place(candidates: CandidateSet) -> int | None:
    """Argmax of the total over feasible places, eq. (5).

    Ties: ``ties.choose_tied_place``.
    """
    first = candidates.totals.find_top()
    if first is None:
        return None
    tied = candidates.totals.list_at_least(candidates.totals[first] - EPSILON, first)
    return first if len(tied) == 1 else choose_tied_place(candidates, tied)


def choose_by_utility(candidates: CandidateSet, constraints: MoveConstraints) -> Choice:
    """The choice of policy utility.

    Without a feasible place a running task stays where it is.
    """
    best = find_best_place(candidates)
    here = candidates.incumbent
    if here is None:
        return (
            Choice(verdict=Verdict.PLACED, reason=Reason.BEST, place=best)
            if best is not None
            else choose_when_nothing_fits(candidates)
        )
    if best is None:
        return _choose_relief(candidates, here, constraints)
    if best == here:
        return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_BEST, place=here)
    if not is_feasible_total(candidates.totals[here]):
        return choose_forced_move(candidates, best, here, constraints)
    return _weigh_voluntary_move(candidates, best, here, constraints)


def choose_forced_move(
    candidates: CandidateSet, best: int, here: int, constraints: MoveConstraints
) -> Choice:
    """The task may not stay, by a rule or because its host is overloaded beyond the slack.

    For a rule between tasks it moves once its dwell has passed, and within ``max_moves``.
    """
    if constraints.frozen:
        return Choice(verdict=Verdict.KEPT, reason=Reason.MOVES_FROZEN, place=here)
    rejection = candidates.denied.get(here)
    if rejection is None:
        return _move_by_load(candidates, best, here, constraints, Reason.FORCED_INFEASIBLE)
    drained = rejection.rule is RejectionRule.CORDONED
    reason = Reason.FORCED_DRAIN if drained else Reason.FORCED_RULE
    patient = rejection.rule in _RULES_BETWEEN_TASKS and not constraints.follows
    held_back = _find_constraint(candidates, here, constraints) if patient else None
    return held_back or Choice(
        verdict=Verdict.PLACED,
        reason=reason,
        place=best,
        subject=candidates.name(here),
        counted=patient,
    )


def _move_by_load(
    candidates: CandidateSet,
    to: int,
    here: int,
    constraints: MoveConstraints,
    reason: Reason,
    gain: float | None = None,
) -> Choice:
    """At once for want of memory or of a link; else once the dwell has passed, and within ``max_moves``."""
    urgent = _is_excess_urgent(candidates, here)
    held_back = None if urgent else _find_constraint(candidates, here, constraints)
    return held_back or Choice(
        verdict=Verdict.PLACED,
        reason=reason,
        place=to,
        subject=candidates.name(here),
        amount=gain,
        counted=not urgent,
    )


def _is_excess_urgent(candidates: CandidateSet, here: int) -> bool:
    """Whether a resource is short that a task cannot go without, or is not there at all."""
    terms, _ = resource_terms_at(candidates, here)
    return any(
        not resource.compressible or terms[resource.name] is None
        for resource in find_excess(candidates, here)
    )


def _find_constraint(candidates: CandidateSet, here: int, constraints: MoveConstraints) -> Choice | None:
    """The constraint on moves that keeps the task at ``here`` for now."""
    min_dwell = candidates.context.policy.min_dwell
    if constraints.dwell_s is not None and constraints.dwell_s < min_dwell:
        left = min_dwell - constraints.dwell_s
        return Choice(verdict=Verdict.KEPT, reason=Reason.DWELL, place=here, amount=left)
    if constraints.moves_left is not None and constraints.moves_left <= 0:
        return Choice(verdict=Verdict.KEPT, reason=Reason.MAX_MOVES, place=here)
    return None


def _choose_relief(candidates: CandidateSet, here: int, constraints: MoveConstraints) -> Choice:
    """No place fits: the task stays, unless a move lowers the worse overload of both hosts by more than the
    margin (ADR 0062).

    On a host that --without treats as gone nothing can stay.
    """
    rejection = candidates.denied.get(here)
    if rejection is not None and rejection.rule is RejectionRule.WITHOUT:
        return replace(choose_when_nothing_fits(candidates), subject=candidates.name(here))
    stay = Choice(verdict=Verdict.KEPT, reason=Reason.NOTHING_FITS, place=here)
    if rejection is not None or constraints.frozen or constraints.in_unit:
        return stay
    if not find_excess(candidates, here):
        return stay
    worst = _compute_shortfalls(candidates)
    now, left = worst.pop(here, None), _compute_worst_share_left(candidates, here)
    if now is None or not worst:
        return stay
    order = candidates.context.fleet.order
    to = min(worst, key=lambda place: (-min(worst[place], left), -worst[place], order[place]))
    gain = min(worst[to], left) - now
    if gain <= candidates.context.policy.move_margin + EPSILON:
        return stay
    return _move_by_load(candidates, to, here, constraints, Reason.RELIEF, gain)


def _compute_worst_share_left(candidates: CandidateSet, here: int) -> float:
    """The least free share at ``here`` once the task has left."""
    ledger = candidates.ledger
    links = [
        ledger.free_links[robot][here]
        for robot in candidates.task.robots
        if here < ledger.fleet.edges and robot in ledger.free_links
    ]
    return min([*(row[here] for row in ledger.free.values()), *links])


def _weigh_voluntary_move(
    candidates: CandidateSet, best: int, here: int, constraints: MoveConstraints
) -> Choice:
    """A move must be worth what it costs (the margin, until that is measured), and nothing may speak against
    moving now.
    """
    policy = candidates.context.policy
    gain = candidates.totals[best] - candidates.totals[here]
    cost = estimate_move_cost(
        candidates.context.handoffs, candidates.task, candidates.name(best), constraints.dwell_s
    )
    needed = policy.move_margin if cost is None else cost.needed
    if gain <= needed + EPSILON:
        reason = Reason.BELOW_MARGIN if cost is None else Reason.COST_ABOVE_GAIN
        return Choice(verdict=Verdict.KEPT, reason=reason, place=here, amount=needed, cost=cost)
    if constraints.frozen:
        return Choice(verdict=Verdict.KEPT, reason=Reason.MOVES_FROZEN, place=here)
    if not constraints.voluntary:
        return Choice(verdict=Verdict.KEPT, reason=Reason.UNSETTLED, place=here)
    held_back = _find_constraint(candidates, here, constraints)
    if held_back is not None:
        return held_back
    reason = Reason.GAIN if cost is None else Reason.GAIN_OVER_COST
    return Choice(
        verdict=Verdict.PLACED,
        reason=reason,
        place=best,
        amount=gain,
        cost=cost,
        voluntary=True,
        counted=True,
    )


def choose_when_nothing_fits(candidates: CandidateSet) -> Choice:
    """No feasible place: the nearest miss; under ``best_effort``, of the policy or of the task, the highest
    total all the same.
    """
    if len(candidates.denied) == len(candidates.listed):
        between = any(entry.rule in _RULES_BETWEEN_TASKS for entry in candidates.denied.values())
        reason = Reason.NO_FEASIBLE_HOST if between else Reason.NO_CANDIDATE
        return Choice(verdict=Verdict.UNPLACED, reason=reason)
    lacking = _compute_shortfalls(candidates)
    if not lacking:
        return Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_FEASIBLE_HOST)
    if candidates.context.policy.best_effort or candidates.task.if_nothing_fits is NothingFits.BEST_EFFORT:
        top = max(candidates.totals[place] for place in lacking)
        tied = [place for place in lacking if candidates.totals[place] >= top - EPSILON]
        place = choose_tied_place(candidates, tied)
        return Choice(verdict=Verdict.PLACED, reason=Reason.BEST_EFFORT, place=place)
    nearest = min(lacking, key=lambda place: (-lacking[place], candidates.context.fleet.order[place]))
    return Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_FEASIBLE_HOST, nearest=nearest)


def _compute_shortfalls(candidates: CandidateSet) -> dict[int, float]:
    """The least term at each candidate that has some capacity."""
    edges = candidates.context.fleet.edges
    found = {
        place: worst
        for place, worst in enumerate(
            compute_worst_terms(candidates.ledger, candidates.context.shares, candidates.task)
        )
        if worst > NO_FREE_SHARE / 2 and place not in candidates.denied
    }
    if candidates.task.hard_deadline:
        for place in found:
            found[place] = min(
                found[place], rate_predicted_latency(candidates.task, latency_at(candidates, place))
            )
    for place in candidates.listed[edges:]:
        terms, _ = resource_terms_at(candidates, place)
        known = [term for resource in HOST_RESOURCES if (term := terms[resource.name]) is not None]
        if place not in candidates.denied and len(known) == len(HOST_RESOURCES):
            found[place] = min(known)
    return found
