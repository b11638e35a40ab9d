"""Eq. (5) with its ties, and handoff avoidance (DESIGN 5.5, 5.8, 5.9)."""

from dataclasses import dataclass

from edgectl.model.assignment import MoveCost, Reason, RejectionRule, Verdict
from edgectl.scheduler.candidates import CandidateSet
from edgectl.scheduler.feasibility import compute_resource_terms
from edgectl.scheduler.ledger import NO_FREE_SHARE
from edgectl.scheduler.move_cost import estimate_move_cost
from edgectl.scheduler.scan import compute_worst_terms, is_feasible_total
from edgectl.scheduler.utility import EPSILON


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What one pass says of one task. ``place`` is None where it is unplaced; ``voluntary``: a move that nothing forced."""

    verdict: Verdict
    reason: Reason
    place: int | None = None
    amount: float | None = None
    cost: MoveCost | None = None
    nearest: int | None = None
    subject: str | None = None
    voluntary: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveConstraints:
    """What may keep a running task where it is. ``dwell_s``: seconds it has been there, None where this plan put it there.

    ``moves_left``: voluntary moves still allowed, None = any. ``voluntary``: whether such moves are allowed at all in this pass.
    """

    frozen: bool = False
    voluntary: bool = True
    dwell_s: float | None = None
    moves_left: int | None = None


def find_best_place(view: CandidateSet) -> int | None:
    """Argmax of the total over feasible places, eq. (5). Ties: incumbent, fewest tasks placed in this pass, natural order."""
    totals = view.totals
    top = max(totals, default=NO_FREE_SHARE)
    if not is_feasible_total(top):
        return None
    first = totals.index(top)
    if (
        max(totals[:first], default=NO_FREE_SHARE)
        < top - EPSILON
        > max(totals[first + 1 :], default=NO_FREE_SHARE)
    ):
        return first  # no tie, the common case: three scans in C instead of one in Python
    return _break_tie(view, [place for place, total in enumerate(totals) if total >= top - EPSILON])


def _break_tie(view: CandidateSet, places: list[int]) -> int:
    order = view.setting.fleet.order
    return min(places, key=lambda place: (place != view.incumbent, view.placed.get(place, 0), order[place]))


def choose_by_utility(view: CandidateSet, brakes: MoveConstraints) -> Choice:
    """The choice of policy utility. A view whose every place is infeasible keeps a running task where it is."""
    best = find_best_place(view)
    here = view.incumbent
    if here is None:
        return (
            Choice(verdict=Verdict.PLACED, reason=Reason.BEST, place=best)
            if best is not None
            else choose_when_nothing_fits(view)
        )
    if best is None:
        return Choice(verdict=Verdict.KEPT, reason=Reason.NOTHING_FITS, place=here)
    if best == here:
        return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_BEST, place=here)
    if not is_feasible_total(view.totals[here]):
        return _choose_forced_move(view, best, here, brakes)
    return _weigh_voluntary_move(view, best, here, brakes)


def _choose_forced_move(view: CandidateSet, best: int, here: int, brakes: MoveConstraints) -> Choice:
    if brakes.frozen:
        return Choice(verdict=Verdict.KEPT, reason=Reason.MOVES_FROZEN, place=here)
    rejection = view.denied.get(here)
    if rejection is None:
        reason = Reason.FORCED_INFEASIBLE
    else:
        reason = Reason.FORCED_DRAIN if rejection.rule is RejectionRule.CORDONED else Reason.FORCED_RULE
    return Choice(verdict=Verdict.PLACED, reason=reason, place=best, subject=view.name(here))


def _weigh_voluntary_move(view: CandidateSet, best: int, here: int, brakes: MoveConstraints) -> Choice:
    """A move must be worth what it costs (the margin, until that is measured), and nothing may speak against moving now."""
    policy = view.setting.policy
    gain = view.totals[best] - view.totals[here]
    cost = estimate_move_cost(view.setting.handoffs, view.task, view.name(best), brakes.dwell_s)
    needed = policy.move_margin if cost is None else cost.needed
    if gain <= needed + EPSILON:
        reason = Reason.BELOW_MARGIN if cost is None else Reason.COST_ABOVE_GAIN
        return Choice(verdict=Verdict.KEPT, reason=reason, place=here, amount=needed, cost=cost)
    if brakes.frozen:
        return Choice(verdict=Verdict.KEPT, reason=Reason.MOVES_FROZEN, place=here)
    if not brakes.voluntary:
        return Choice(verdict=Verdict.KEPT, reason=Reason.UNSETTLED, place=here)
    if brakes.dwell_s is not None and brakes.dwell_s < policy.min_dwell:
        return Choice(
            verdict=Verdict.KEPT, reason=Reason.DWELL, place=here, amount=policy.min_dwell - brakes.dwell_s
        )
    if brakes.moves_left is not None and brakes.moves_left <= 0:
        return Choice(verdict=Verdict.KEPT, reason=Reason.MAX_MOVES, place=here)
    reason = Reason.GAIN if cost is None else Reason.GAIN_OVER_COST
    return Choice(verdict=Verdict.PLACED, reason=reason, place=best, amount=gain, cost=cost, voluntary=True)


def choose_when_nothing_fits(view: CandidateSet) -> Choice:
    """No feasible place: the nearest miss, or under ``best_effort`` the highest total all the same."""
    if len(view.denied) == len(view.listed):
        return Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_CANDIDATE)
    lacking = _compute_shortfalls(view)
    if not lacking:
        return Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_FEASIBLE_HOST)
    if view.setting.policy.best_effort:
        top = max(view.totals[place] for place in lacking)
        tied = [place for place in lacking if view.totals[place] >= top - EPSILON]
        return Choice(verdict=Verdict.PLACED, reason=Reason.BEST_EFFORT, place=_break_tie(view, tied))
    nearest = min(lacking, key=lambda place: (-lacking[place], view.setting.fleet.order[place]))
    return Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_FEASIBLE_HOST, nearest=nearest)


def _compute_shortfalls(view: CandidateSet) -> dict[int, float]:
    """The least term at each candidate that has some capacity."""
    edges = view.setting.fleet.edges
    found = {
        place: worst
        for place, worst in enumerate(compute_worst_terms(view.ledger, view.setting.shares, view.task))
        if worst > NO_FREE_SHARE / 2 and place not in view.denied
    }
    for place in view.listed[edges:]:
        reading = compute_resource_terms(view.ledger, view.task, place)
        if place not in view.denied and reading.cpu is not None and reading.memory is not None:
            found[place] = min(reading.cpu, reading.memory)
    return found
