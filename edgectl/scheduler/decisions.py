"""From a choice to the decision that is kept: relative to what really runs, with every number (DESIGN section 4)."""

from dataclasses import replace

from edgectl.model.assignment import Decision, RankedHost, Reason, Verdict
from edgectl.model.policy import Weights
from edgectl.model.task import Task
from edgectl.scheduler.candidates import CandidateSet
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.demand import list_resource_demands
from edgectl.scheduler.ranking import rank_hosts
from edgectl.scheduler.scan import is_feasible_total
from edgectl.scheduler.utility import EPSILON


def rebase_on_initial(choice: Choice, origin: int | None, carried: Choice | None) -> Choice:
    """The choice of a later pass, told from where the task really runs (``origin``); ``carried`` first put it where it is now."""
    if choice.verdict is Verdict.PLACED and choice.place == origin:
        return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_BEST, place=origin)
    if choice.verdict is Verdict.KEPT and choice.place != origin and carried is not None:
        return replace(carried, place=choice.place)
    return choice


def unplaced_decision(task: Task, choice: Choice) -> Decision:
    """A decision that looked at no host."""
    return Decision(task=task.name, verdict=choice.verdict, reason=choice.reason, subject=choice.subject)


def explain_replacement(decision: Decision, silent: str | None) -> Decision:
    """The decision as it is told of a task whose copy on the host ``silent`` was given up; None: of any other task."""
    if silent is None:
        return decision
    if decision.verdict is Verdict.PLACED:
        decision = replace(decision, reason=Reason.REPLACED, subject=silent)
    return replace(decision, previous_host=silent)


def build_decision(view: CandidateSet, choice: Choice, origin: int | None) -> Decision:
    """The decision on one task with its ranking. ``origin``: where it really runs."""
    ranked, left_out = rank_hosts(view, choice.place)
    host = _get_place_name(view.setting.fleet, choice.place)
    entry = next((entry for entry in ranked if entry.host == host), None)
    other = next((entry for entry in ranked if entry.feasible and entry.host != host), None)
    total = entry.total if entry else None
    reason, subject = _refine_reason(view, choice, ranked)
    place = choice.place if choice.place is not None else choice.nearest
    return Decision(
        task=view.task.name,
        verdict=choice.verdict,
        reason=reason,
        host=host,
        previous_host=_get_place_name(view.setting.fleet, origin),
        total=total,
        lead=None if total is None or other is None or other.total is None else total - other.total,
        challenger=other.host if other and host is not None else None,
        subject=subject,
        amount=_compute_gain(view, choice, origin) if choice.voluntary else choice.amount,
        cost=choice.cost,
        nearest=_get_place_name(view.setting.fleet, choice.nearest),
        overcommitted=entry is not None and _is_overcommitted(entry),
        ranking=ranked,
        rejection_counts=left_out,
        demand=list_resource_demands(view.setting.fleet, view.task, place) if place is not None else (),
    )


def _get_place_name(fleet: Capacities, place: int | None) -> str | None:
    return None if place is None else fleet.places[place].name


def _compute_gain(view: CandidateSet, choice: Choice, origin: int | None) -> float | None:
    """By how much the chosen host beats the real one; as it was at the move where the real one no longer fits."""
    if choice.place is None or origin is None or not is_feasible_total(view.totals[origin]):
        return choice.amount
    return view.totals[choice.place] - view.totals[origin]


def _is_overcommitted(entry: RankedHost) -> bool:
    terms = (entry.terms.cpu, entry.terms.memory, entry.terms.network)
    return any(term is not None and term < -EPSILON for term in terms)


def _refine_reason(
    view: CandidateSet, choice: Choice, ranked: tuple[RankedHost, ...]
) -> tuple[Reason, str | None]:
    """Why the best place won: it was pinned, alone, or nearer to a predecessor."""
    feasible = [entry.host for entry in ranked if entry.feasible]
    if choice.reason is not Reason.BEST or choice.place is None:
        return choice.reason, choice.subject
    if view.task.hosts.pin is not None:
        return Reason.PINNED, choice.subject
    host = view.name(choice.place)
    if feasible == [host]:
        return Reason.ONLY_FEASIBLE, choice.subject
    # Policy paper places where nothing fits, so the chosen host need not be among the feasible.
    weighed = [entry for entry in ranked if entry.feasible or entry.host == host]
    if choice.place in view.located and _is_decided_by_affinity(weighed, view.setting.policy.weights, host):
        return Reason.WITH_PREDECESSOR, _find_predecessor_at(view, choice.place)
    return choice.reason, choice.subject


def _is_decided_by_affinity(weighed: list[RankedHost], weights: Weights, host: str) -> bool:
    """Whether another host would have won on resources alone."""
    without = {
        entry.host: (entry.total or 0.0) - weights.task * (entry.terms.task or 0.0) for entry in weighed
    }
    return without[host] < max(without.values()) - EPSILON


def _find_predecessor_at(view: CandidateSet, place: int) -> str | None:
    return next((name for name, located in view.predecessors.items() if located == place), None)
