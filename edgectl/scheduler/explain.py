# SPDX-License-Identifier: Apache-2.0
"""Explanation of a decision: its terms, and the smallest single changes that would reverse it.

Decides nothing anew. Each change is of one number: the load of one host or link, or one weight; all other
tasks stay where they are and use what they use. Eq. (4) is linear in each of these, so the crossing is known
in closed form (``sensitivity``).
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf, sqrt

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Decision, RankedHost, Reason, RejectionRule, UtilityTerms, Verdict
from edgectl.model.explanation import ChangeKind, Contribution, Explanation, Flip, Tie, TieRule
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy, Weights
from edgectl.model.resource import (
    LATENCY,
    NOTHING,
    RESOURCES,
    RESOURCES_BY_NAME,
    SPARE_TERMS,
    TERMS,
    Resource,
    ResourceMap,
)
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task
from edgectl.scheduler.capacities import Capacities, build_capacities
from edgectl.scheduler.latency import is_latency_weighed
from edgectl.scheduler.ledger import Ledger, build_measured_ledger, compute_measured_usage
from edgectl.scheduler.move_cost import HandoffHistory, collect_handoff_history, estimate_move_cost
from edgectl.scheduler.policies import POLICIES
from edgectl.scheduler.preference import sign_weights
from edgectl.scheduler.sensitivity import Contender, LinearFunction, find_first_change, find_winner
from edgectl.scheduler.utility import EPSILON

# A weight is changed within 0..1; where it is 1 already the others have no shares to grow by. At the very
# ends a crossing is rounding.
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
    Reason.PINNED_BY_OPERATOR,
    Reason.STANDBY_ACTIVATED,
    Reason.MADE_ROOM,
    Reason.ROOM_MADE,
    Reason.PREEMPTED,
    Reason.REBALANCED,
    Reason.RELIEF,
    Reason.TOGETHER,
    Reason.GROUP,
)
_EXPLAINABLE_VERDICTS = (Verdict.PLACED, Verdict.KEPT, Verdict.UNPLACED)


class TermNoise(ResourceMap[float]):
    """Standard deviation of a host's terms over its last samples by resource: shares of its capacity."""

    __slots__ = ()
    DEFAULTS = dict.fromkeys(RESOURCES_BY_NAME, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Case:
    """One decision with all that a change of it needs. ``ranked``: the candidates that have a total."""

    task: Task
    decision: Decision
    policy: Policy
    weights: Weights
    fleet: Capacities
    ledger: Ledger
    ranked: tuple[RankedHost, ...]
    needed: Mapping[str, float]


def explain_decision(
    inventory: Inventory,
    task: Task,
    snapshot: Snapshot,
    decision: Decision,
    policy: Policy,
    noise: Mapping[str, TermNoise] | None = None,
) -> Explanation:
    """The decision on ``task`` taken apart (eqs. 1-5).

    ``policy`` with the weights as used; ``noise`` by host, where it is known.
    """
    policy = sign_weights(policy)
    manager = snapshot.manager or ManagerState()
    ranked = tuple(
        entry for entry in decision.ranking if entry.total is not None and _is_only_short_of_resources(entry)
    )
    fleet = build_capacities(inventory, snapshot, manager, policy.without)
    case = _Case(
        task=task,
        decision=decision,
        policy=policy,
        weights=policy.weights,
        fleet=fleet,
        ledger=_build_ledger_of_others(fleet),
        ranked=ranked,
        needed=_compute_needed_gains(
            task,
            decision,
            ranked,
            policy.move_margin,
            collect_handoff_history(manager),
            _compute_dwell_s(manager, task, snapshot.taken_at),
        ),
    )
    plain = Explanation(
        decision=decision,
        weights=policy.weights,
        linear=len(task.robots) <= 1,
        pin=task.hosts.pin,
        deadline_ms=None if task.deadline is None else 1000.0 * task.deadline,
        bends=is_latency_weighed(policy, task),
        rule=None if POLICIES[policy.name].weighs_moves else policy.name,
    )
    here = _find_ranked_host(ranked, decision.host)
    there = _find_ranked_host(ranked, decision.challenger)
    if here is not None and there is not None:
        plain = replace(
            plain,
            runner_up=there.host,
            contributions=tuple(_build_contributions(policy.weights, here.terms, there.terms)),
        )
    if (
        not POLICIES[policy.name].weighs_moves
        or decision.verdict not in _EXPLAINABLE_VERDICTS
        or decision.reason in _CONSTRAINED_REASONS
        or not _is_decided_by_totals(case)
        or (decision.reason is Reason.NOTHING_FITS and here is not None)
    ):
        return plain
    lead_noise = _compute_lead_noise(policy.weights, noise or {}, here, there)
    return replace(
        plain,
        slack=_compute_slack(case),
        noise=lead_noise,
        weighed=True,
        flips=tuple(sorted(_find_flips(case), key=lambda flip: flip.size)),
    )


def find_tie(decision: Decision, earlier: Sequence[Decision]) -> Tie | None:
    """The hosts that are equal to the chosen one, and what decided between them.

    ``earlier``: the decisions before it, in sequence order.
    """
    equal = tuple(
        entry.host
        for entry in decision.ranking
        if entry.feasible
        and entry.host != decision.host
        and None not in (entry.total, decision.total)
        and abs((entry.total or 0.0) - (decision.total or 0.0)) <= EPSILON
    )
    if not equal or decision.host is None:
        return None
    return Tie(hosts=equal, rule=_find_tie_rule(decision, equal, earlier))


def _find_tie_rule(decision: Decision, equal: Sequence[str], earlier: Sequence[Decision]) -> TieRule:
    if decision.previous_host == decision.host:
        return TieRule.RUNS_THERE
    free = {
        entry.host: sum(entry.terms[resource.name] or 0.0 for resource in RESOURCES)
        for entry in decision.ranking
    }
    chosen = decision.host or ""
    rivals = [host for host in equal if abs(free[host] - free[chosen]) <= EPSILON]
    if not rivals:
        return TieRule.FREE_SHARE
    counts = Counter(other.host for other in earlier)
    return TieRule.FEWEST_TASKS if all(counts[host] > counts[chosen] for host in rivals) else TieRule.NAMES


def _is_decided_by_totals(case: _Case) -> bool:
    """Whether eq. (5) with handoff avoidance gives the decision; else no change of a number explains it."""
    runners = [_build_contender(case, entry) for entry in case.ranked]
    return find_winner(runners, case.decision.previous_host, 0.0) == case.decision.host


def _build_ledger_of_others(fleet: Capacities) -> Ledger:
    """The measured load without that of tasks: a task counts for its reservation, whatever it uses less."""
    ledger = build_measured_ledger(fleet)
    for place, sample in enumerate(fleet.samples):
        for run in sample.instances.values() if sample is not None and sample.ok else ():
            if run.state.alive:
                ledger.release(place, compute_measured_usage(fleet, run, None, place))
    return ledger


def _is_only_short_of_resources(entry: RankedHost) -> bool:
    """True where only a lack of resources speaks against the host."""
    return all(rejection.rule is RejectionRule.INSUFFICIENT for rejection in entry.rejections)


def _find_ranked_host(ranked: Sequence[RankedHost], host: str | None) -> RankedHost | None:
    return next((entry for entry in ranked if entry.host == host), None)


def _compute_dwell_s(manager: ManagerState, task: Task, now: float) -> float | None:
    placement = manager.placements.get(task.name)
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


def _build_contributions(weights: Weights, here: UtilityTerms, there: UtilityTerms) -> Iterator[Contribution]:
    for term in TERMS:
        if term in SPARE_TERMS and not weights[term]:
            continue
        yield Contribution(
            term=term,
            weight=weights[term],
            here=_get_term_value(here, term),
            there=_get_term_value(there, term),
        )


def _get_term_value(terms: UtilityTerms, term: str) -> float:
    return terms[term] or 0.0


def _compute_lead_noise(
    weights: Weights, noise: Mapping[str, TermNoise], here: RankedHost | None, there: RankedHost | None
) -> float | None:
    """Standard deviation of the difference of two totals whose loads vary independently."""
    if here is None or there is None or here.host not in noise or there.host not in noise:
        return None
    each = (noise[here.host], noise[there.host])
    return sqrt(sum(sum((weights[name] * share) ** 2 for name, share in n.items()) for n in each))


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
    case: _Case,
    entry: RankedHost,
    *,
    total: LinearFunction | None = None,
    term: str | None = None,
    slope: float = 0.0,
) -> Contender:
    """``entry`` while its total, or one of its terms, changes."""
    terms = tuple(
        LinearFunction(_get_term_value(entry.terms, each), slope if each == term else 0.0)
        for each in RESOURCES_BY_NAME
    )
    return Contender(
        host=entry.host,
        total=total or LinearFunction(entry.total or 0.0),
        terms=terms,
        needed=case.needed[entry.host],
        slacks=tuple(
            case.fleet.get_slack(resource, case.fleet.index[entry.host])
            if entry.host == case.decision.previous_host
            else 0.0
            for resource in RESOURCES
        ),
    )


def _find_flips(case: _Case) -> Iterator[Flip]:
    for entry in case.ranked if not is_latency_weighed(case.policy, case.task) else ():
        for resource in RESOURCES:
            yield from _find_load_flips(case, entry, resource)
    predicted = any(entry.predicted_latency is not None for entry in case.ranked)
    for term in TERMS:
        if term not in SPARE_TERMS or case.weights[term] or (term == LATENCY and predicted):
            yield from _find_weight_flips(case, term)


def _find_load_flips(case: _Case, entry: RankedHost, resource: Resource) -> Iterator[Flip]:
    """The load of one host, or of its link, rises or falls; it cannot fall below what was measured."""
    capacity, used, robot = _get_capacity_and_load(case, entry.host, resource)
    if not capacity:
        return
    term = resource.name
    for change, sign, end in (
        (ChangeKind.LOAD_RISES, -1.0, float("inf")),
        (ChangeKind.LOAD_FALLS, 1.0, used),
    ):
        slope = sign / capacity
        moving = LinearFunction(entry.total or 0.0, case.weights[term] * slope)
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
                change=change,
                term=term,
                amount=amount,
                size=size,
                winner=then,
                host=entry.host,
                robot=robot,
                unit=capacity,
            )


def _get_capacity_and_load(case: _Case, host: str, resource: Resource) -> tuple[float, float, str | None]:
    """Delta and what others than tasks use of ``resource`` at ``host``, and the robot of a link.

    Delta is 0 where no single load makes the term.
    """
    fleet, place, ledger = case.fleet, case.fleet.index[host], case.ledger
    if not resource.per_link:
        capacity = fleet.usable[resource.name][place]
        return (capacity if NOTHING < capacity < inf else 0.0), ledger.used[resource.name][place], None
    if len(case.task.robots) != 1 or place >= fleet.edges:
        return 0.0, 0.0, None
    robot = case.task.robots[0]
    return fleet.links[robot][place] or 0.0, ledger.links[robot][place], robot


def _find_weight_flips(case: _Case, term: str) -> Iterator[Flip]:
    """One weight rises or falls, the others sharing the rest as they do now."""
    weight = case.weights[term]
    if weight >= _WHOLE_WEIGHT or min(case.weights.values()) < 0:
        return  # weights of full hosts that are preferred: their signs are no shares
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
    weights: Weights, entry: RankedHost, term: str, weight: float, sign: float
) -> LinearFunction:
    """Eq. (4) while the weight of ``term`` is ``weight + sign * x``."""
    value = _get_term_value(entry.terms, term)
    rest = sum(weights[each] * _get_term_value(entry.terms, each) for each in TERMS if each != term) / (
        1.0 - weight
    )
    return LinearFunction(weight * value + (1.0 - weight) * rest, sign * (value - rest))
