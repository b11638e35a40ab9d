"""Decisions out of choices: relative to what really runs, with every number."""

from dataclasses import replace

from edgectl.model.assignment import Decision, Reason, RejectionRule, Verdict
from edgectl.model.resource import AFFINITY, RESOURCES
from edgectl.model.task import Task
from edgectl.scheduler.candidates import CandidateSet
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.lazy_ranking import LazyCounts, LazyDemands, LazyRanking, RankingRequest
from edgectl.scheduler.ranking import ScoredPlace, exclude_places, find_challenger, score_place
from edgectl.scheduler.scan import EXCLUDED_TOTAL, is_feasible_total
from edgectl.scheduler.utility import EPSILON

# The whole plan is the reason of such a place.
_IMPROVED = (Reason.REBALANCED, Reason.OPTIMAL)


def rebase_on_initial(choice: Choice, initial_place: int | None, prior_move: Choice | None) -> Choice:
    """The choice of a later pass relative to the place where the task really runs.

    ``prior_move`` first moved it.
    """
    if prior_move is not None and prior_move.reason in _IMPROVED and choice.place != initial_place:
        return replace(prior_move, place=choice.place)
    if prior_move is not None and prior_move.reason in (Reason.MADE_ROOM, Reason.PREEMPTED):
        if choice.place is None:
            return replace(choice, reason=Reason.PREEMPTED, subject=prior_move.subject)
        if choice.place != initial_place:
            return replace(prior_move, verdict=Verdict.PLACED, reason=Reason.MADE_ROOM, place=choice.place)
    if choice.verdict is Verdict.PLACED and choice.place == initial_place:
        return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_BEST, place=initial_place)
    if choice.verdict is Verdict.KEPT and choice.place != initial_place and prior_move is not None:
        return replace(prior_move, place=choice.place)
    return choice


def unplaced_decision(task: Task, choice: Choice) -> Decision:
    """A decision without a ranking."""
    return Decision(task=task.name, verdict=choice.verdict, reason=choice.reason, subject=choice.subject)


def build_plain_decision(
    fleet: Capacities, task: Task, choice: Choice, initial_place: int | None
) -> Decision:
    """A decision without its numbers: verdict, reason and hosts."""
    return Decision(
        task=task.name,
        verdict=choice.verdict,
        reason=choice.reason,
        host=_get_place_name(fleet, choice.place),
        previous_host=_get_place_name(fleet, initial_place),
        subject=choice.subject,
    )


def explain_replacement(decision: Decision, silent: str | None) -> Decision:
    """The decision, adjusted for a task replaced from the unreachable host ``silent``; None: not replaced."""
    if silent is None:
        return decision
    if decision.verdict is Verdict.PLACED:
        decision = replace(decision, reason=Reason.REPLACED, subject=silent)
    return replace(decision, previous_host=silent)


def build_decision(
    candidates: CandidateSet, choice: Choice, initial_place: int | None, ranking: RankingRequest
) -> Decision:
    """The decision on one task. ``initial_place``: the place where it really runs; ``ranking`` is made when
    it is read.
    """
    fleet = candidates.context.fleet
    entry = None if choice.place is None else score_place(candidates, choice.place)
    other = find_challenger(candidates, choice.place)
    total = entry.total if entry else None
    reason, subject = _refine_reason(candidates, choice, entry, other)
    place = choice.place if choice.place is not None else choice.nearest
    return Decision(
        task=candidates.task.name,
        verdict=choice.verdict,
        reason=reason,
        host=_get_place_name(fleet, choice.place),
        previous_host=_get_place_name(fleet, initial_place),
        total=total,
        lead=None if total is None or other is None or other.total is None else total - other.total,
        challenger=candidates.name(other.place) if other and choice.place is not None else None,
        subject=subject,
        amount=_compute_gain(candidates, choice, initial_place)
        if choice.voluntary and choice.reason not in (Reason.MADE_ROOM, *_IMPROVED)
        else choice.amount,
        cost=choice.cost,
        nearest=_get_place_name(fleet, choice.nearest),
        overcommitted=entry is not None and _is_overcommitted(entry),
        ranking=LazyRanking(ranking),
        rejection_counts=LazyCounts(ranking),
        demand=LazyDemands(ranking, place) if place is not None else (),
    )


def _get_place_name(fleet: Capacities, place: int | None) -> str | None:
    return None if place is None else fleet.places[place].name


def _compute_gain(candidates: CandidateSet, choice: Choice, initial_place: int | None) -> float | None:
    """By how much the chosen host beats the real one.

    As it was at the move where the real one no longer fits.
    """
    if (
        choice.place is None
        or initial_place is None
        or not is_feasible_total(candidates.totals[initial_place])
    ):
        return choice.amount
    return candidates.totals[choice.place] - candidates.totals[initial_place]


def _is_overcommitted(entry: ScoredPlace) -> bool:
    terms = (entry.terms[resource.name] for resource in RESOURCES)
    return any(term is not None and term < -EPSILON for term in terms)


def _refine_reason(
    candidates: CandidateSet, choice: Choice, entry: ScoredPlace | None, other: ScoredPlace | None
) -> tuple[Reason, str | None]:
    """The reason that the best place won: it was pinned, alone, or nearer to a predecessor."""
    mate = next(
        (denied.task for denied in candidates.denied.values() if denied.rule is RejectionRule.TOGETHER), None
    )
    alone = other is None and entry is not None and not entry.rejections
    if mate is not None and alone and choice.reason in (Reason.BEST, Reason.STILL_BEST):
        return Reason.TOGETHER, mate
    if choice.reason is not Reason.BEST or entry is None:
        return choice.reason, choice.subject
    if candidates.task.hosts.pin is not None:
        return Reason.PINNED, choice.subject
    # Policy paper places where nothing fits, so the chosen host need not be among the feasible.
    if other is None and not entry.rejections:
        return Reason.ONLY_FEASIBLE, choice.subject
    if entry.place in candidates.located and _is_decided_by_affinity(candidates, entry):
        return Reason.WITH_PREDECESSOR, _find_predecessor_at(candidates, entry.place)
    return choice.reason, choice.subject


def _is_decided_by_affinity(candidates: CandidateSet, entry: ScoredPlace) -> bool:
    """True where another host would have won on resources alone.

    Of all places without a predecessor only the best needs a look: their affinity is the same.
    """
    weight = candidates.context.policy.weights[AFFINITY]
    far = exclude_places(candidates, candidates.located).find_top()
    near = {place for place in candidates.located if is_feasible_total(candidates.totals[place])}
    rivals = [score_place(candidates, place) for place in (*near, far) if place is not None]
    best = max(
        (_subtract_affinity(rival, weight) for rival in rivals if not rival.rejections),
        default=EXCLUDED_TOTAL,
    )
    return _subtract_affinity(entry, weight) < best - EPSILON


def _subtract_affinity(entry: ScoredPlace, weight: float) -> float:
    return (entry.total or 0.0) - weight * (entry.terms[AFFINITY] or 0.0)


def _find_predecessor_at(candidates: CandidateSet, place: int) -> str | None:
    return next((name for name, located in candidates.predecessors.items() if located == place), None)
