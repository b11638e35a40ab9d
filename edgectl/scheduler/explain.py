"""Why a task goes where it goes, and the smallest single changes that would send it elsewhere. Reads the decision; decides nothing anew.

Each change is of one number: the load of one host or link, or one weight; all other tasks stay where they are and use what they use.
Eq. (4) is linear in each of these, so the crossing is known in closed form (``race``).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt

from edgectl.model.assignment import Decision, RankedHost, Reason, RejectionRule, Terms, Verdict
from edgectl.model.explanation import ChangeKind, Contribution, Explanation, Flip, Term
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy, PolicyName, Weights
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task
from edgectl.scheduler.capacities import Capacities, build_capacities
from edgectl.scheduler.ledger import Ledger, build_measured_ledger
from edgectl.scheduler.move_cost import HandoffHistory, collect_handoff_history, estimate_move_cost
from edgectl.scheduler.sensitivity import Contender, LinearFunction, find_first_change

# A weight is changed within 0..1; where it is 1 already the others have no shares to grow by. At the very ends a crossing is rounding.
_WHOLE_WEIGHT = 1.0
_SHARE_BELOW_END = 1.0 - 1e-6
# Here something other than the totals decided, and no change of a number is the answer.
_CONSTRAINED_REASONS = (
    Reason.DWELL,
    Reason.MAX_MOVES,
    Reason.MOVES_FROZEN,
    Reason.UNSETTLED,
    Reason.BEST_EFFORT,
    Reason.REPLACED,
)
_EXPLAINABLE_VERDICTS = (Verdict.PLACED, Verdict.KEPT, Verdict.UNPLACED)


@dataclass(frozen=True, slots=True, kw_only=True)
class TermNoise:
    """Standard deviation of a host's terms over its last samples: shares of its capacity."""

    cpu: float = 0.0
    memory: float = 0.0
    network: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Case:
    """One decision with all that a change of it needs. ``ranked``: the candidates that have a total."""

    task: Task
    decision: Decision
    weights: Weights
    fleet: Capacities
    ledger: Ledger
    ranked: tuple[RankedHost, ...]
    needed: Mapping[str, float]


def explain_decision(
    inventory: Inventory, task: Task, snapshot: Snapshot, decision: Decision, policy: Policy, noise: Mapping[str, TermNoise] | None = None
) -> Explanation:  # fmt: skip
    """The decision on ``task`` taken apart (eqs. 1-5). ``policy`` with the weights as used; ``noise`` by host, where it is known."""
    memory = snapshot.manager or ManagerState()
    ranked = tuple(
        entry for entry in decision.ranking if entry.total is not None and _is_only_short_of_resources(entry)
    )
    fleet = build_capacities(inventory, snapshot, memory, policy.without)
    case = _Case(
        task=task,
        decision=decision,
        weights=policy.weights,
        fleet=fleet,
        ledger=build_measured_ledger(fleet),
        ranked=ranked,
        needed=_compute_needed_gains(
            task,
            decision,
            ranked,
            policy.move_margin,
            collect_handoff_history(memory),
            _compute_dwell_s(memory, task, snapshot.taken_at),
        ),
    )
    plain = Explanation(decision=decision, weights=policy.weights, linear=len(task.robots) <= 1)
    here = _find_ranked_host(ranked, decision.host)
    there = _find_ranked_host(ranked, decision.challenger)
    if here is not None and there is not None:
        plain = replace(
            plain,
            runner_up=there.host,
            contributions=tuple(_build_contributions(policy.weights, here.terms, there.terms)),
        )
    if (
        policy.name is not PolicyName.UTILITY
        or decision.verdict not in _EXPLAINABLE_VERDICTS
        or decision.reason in _CONSTRAINED_REASONS
    ):
        return plain
    lead_noise = _compute_lead_noise(policy.weights, noise or {}, here, there)
    return replace(
        plain,
        slack=_compute_slack(case),
        noise=lead_noise,
        flips=tuple(sorted(_find_flips(case), key=lambda flip: flip.size)),
    )


def _is_only_short_of_resources(entry: RankedHost) -> bool:
    """Whether nothing but a lack of resources speaks against the host."""
    return all(rejection.rule is RejectionRule.INSUFFICIENT for rejection in entry.rejections)


def _find_ranked_host(ranked: Sequence[RankedHost], host: str | None) -> RankedHost | None:
    return next((entry for entry in ranked if entry.host == host), None)


def _compute_dwell_s(memory: ManagerState, task: Task, now: float) -> float | None:
    placement = memory.placements.get(task.name)
    return None if placement is None else now - placement.since


def _compute_needed_gains(
    task: Task,
    decision: Decision,
    ranked: Sequence[RankedHost],
    margin: float,
    handoffs: HandoffHistory,
    here_s: float | None,
) -> dict[str, float]:
    """By host: the gain that a move to it takes."""
    found = {}
    for entry in ranked:
        cost = estimate_move_cost(handoffs, task, entry.host, here_s)
        found[entry.host] = margin if cost is None else cost.needed
    if decision.cost is not None and decision.challenger in found:
        mover = decision.host if decision.verdict is Verdict.PLACED else decision.challenger
        found[mover or decision.challenger] = decision.cost.needed
    return found


def _build_contributions(weights: Weights, here: Terms, there: Terms) -> Iterator[Contribution]:
    for term in Term:
        yield Contribution(
            term=term,
            weight=_get_weight(weights, term),
            here=_get_term_value(here, term),
            there=_get_term_value(there, term),
        )


def _get_weight(weights: Weights, term: Term) -> float:
    return float(getattr(weights, term))


def _get_term_value(terms: Terms, term: Term) -> float:
    return float(getattr(terms, term) or 0.0)


def _compute_lead_noise(
    weights: Weights, noise: Mapping[str, TermNoise], here: RankedHost | None, there: RankedHost | None
) -> float | None:
    """Standard deviation of the difference of two totals whose loads vary independently."""
    if here is None or there is None or here.host not in noise or there.host not in noise:
        return None
    each = (noise[here.host], noise[there.host])
    return sqrt(
        sum(
            (weights.cpu * n.cpu) ** 2 + (weights.memory * n.memory) ** 2 + (weights.network * n.network) ** 2
            for n in each
        )
    )


def _compute_slack(case: _Case) -> float | None:
    """By how much the chosen host's total may fall, its terms staying feasible."""
    here = case.decision.host
    runners = [
        _build_contender(
            case, entry, total=LinearFunction(entry.total or 0.0, -1.0 if entry.host == here else 0.0)
        )
        for entry in case.ranked
    ]
    found = (
        find_first_change(runners, case.decision.previous_host, float("inf"), 1.0)
        if here is not None
        else None
    )
    return found[0] if found else None


def _build_contender(
    case: _Case, entry: RankedHost, *, total: LinearFunction | None = None, term: Term | None = None, slope: float = 0.0
) -> Contender:  # fmt: skip
    """``entry`` while its total, or one of its terms, changes."""
    terms = tuple(
        LinearFunction(_get_term_value(entry.terms, each), slope if each is term else 0.0)
        for each in (Term.CPU, Term.MEMORY, Term.NETWORK)
    )
    return Contender(
        host=entry.host,
        total=total or LinearFunction(entry.total or 0.0),
        terms=terms,
        needed=case.needed[entry.host],
    )


def _find_flips(case: _Case) -> Iterator[Flip]:
    for entry in case.ranked:
        for term in (Term.CPU, Term.MEMORY, Term.NETWORK):
            yield from _find_load_flips(case, entry, term)
    for term in Term:
        yield from _find_weight_flips(case, term)


def _find_load_flips(case: _Case, entry: RankedHost, term: Term) -> Iterator[Flip]:
    """The load of one host, or of its link, rises or falls; it cannot fall below what was measured."""
    capacity, used, robot = _get_capacity_and_load(case, entry.host, term)
    if not capacity:
        return
    for change, sign, end in (
        (ChangeKind.LOAD_RISES, -1.0, float("inf")),
        (ChangeKind.LOAD_FALLS, 1.0, used),
    ):
        slope = sign / capacity
        moving = LinearFunction(entry.total or 0.0, _get_weight(case.weights, term) * slope)
        runners = [
            _build_contender(case, each, total=moving, term=term, slope=slope)
            if each is entry
            else _build_contender(case, each)
            for each in case.ranked
        ]
        found = find_first_change(runners, case.decision.previous_host, end, capacity)
        if found is not None:
            amount, then = found
            size = amount / capacity
            yield Flip(
                change=change, term=term, amount=amount, size=size, winner=then, host=entry.host, robot=robot
            )


def _get_capacity_and_load(case: _Case, host: str, term: Term) -> tuple[float, float, str | None]:
    """Delta and the measured gamma of ``term`` at ``host``, and the robot of a link; Delta is 0 where no single load makes the term."""
    fleet, place, ledger = case.fleet, case.fleet.index[host], case.ledger
    if term is Term.CPU:
        return fleet.cpu[place], ledger.cpu[place], None
    if term is Term.MEMORY:
        return fleet.memory[place], ledger.memory[place], None
    if len(case.task.robots) != 1 or place >= fleet.edges:
        return 0.0, 0.0, None
    robot = case.task.robots[0]
    return fleet.links[robot][place] or 0.0, ledger.links[robot][place], robot


def _find_weight_flips(case: _Case, term: Term) -> Iterator[Flip]:
    """One weight rises or falls, the others sharing the rest as they do now."""
    weight = _get_weight(case.weights, term)
    if weight >= _WHOLE_WEIGHT:
        return
    for change, sign, end in (
        (ChangeKind.WEIGHT_RISES, 1.0, _WHOLE_WEIGHT - weight),
        (ChangeKind.WEIGHT_FALLS, -1.0, weight),
    ):
        runners = [
            _build_contender(
                case, entry, total=_build_weighted_total(case.weights, entry, term, weight, sign)
            )
            for entry in case.ranked
        ]
        found = find_first_change(runners, case.decision.previous_host, end * _SHARE_BELOW_END, _WHOLE_WEIGHT)
        if found is not None:
            size, then = found
            yield Flip(change=change, term=term, amount=weight + sign * size, size=size, winner=then)


def _build_weighted_total(
    weights: Weights, entry: RankedHost, term: Term, weight: float, sign: float
) -> LinearFunction:
    """Eq. (4) while the weight of ``term`` is ``weight + sign * x``."""
    value = _get_term_value(entry.terms, term)
    rest = sum(
        _get_weight(weights, each) * _get_term_value(entry.terms, each) for each in Term if each is not term
    ) / (1.0 - weight)
    return LinearFunction(weight * value + (1.0 - weight) * rest, sign * (value - rest))
