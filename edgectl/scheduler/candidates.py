# SPDX-License-Identifier: Apache-2.0
"""Candidates of one task: the places that may take it, and the total of each."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Rejection, RejectionRule, UtilityTerms
from edgectl.model.policy import Policy, Preference
from edgectl.model.predicted_latency import PredictedLatency
from edgectl.model.resource import AFFINITY, LATENCY, RATING, RESOURCES, Resource
from edgectl.model.task import OnboardRule, Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.feasibility import (
    compute_resource_terms,
    find_missing_engine,
    find_own_robot,
    find_rule_against,
)
from edgectl.scheduler.latency import (
    NO_LATENCY_TERM,
    is_latency_weighed,
    list_latency_terms,
    predict_latency,
    rate_predicted_latency,
    reject_missed_deadline,
)
from edgectl.scheduler.ledger import Ledger, compute_demand_usage
from edgectl.scheduler.move_cost import HandoffHistory
from edgectl.scheduler.placement_rules import NO_RULES, PlacementRules
from edgectl.scheduler.ratings import Ratings, get_rating
from edgectl.scheduler.scan import (
    EXCLUDED_TOTAL,
    INFEASIBLE_PENALTY,
    DemandShares,
    ListTotals,
    compute_resource_totals,
    is_feasible_total,
)
from edgectl.scheduler.task_usage import TaskUsage
from edgectl.scheduler.utility import EPSILON, compute_affinity, total_utility

if TYPE_CHECKING:  # NumPy is imported only where it pays
    from edgectl.scheduler.array_scan import ArrayScan, ArrayTotals

Totals: TypeAlias = "ListTotals | ArrayTotals"
# All terms of one place, the total, and what is lacking there.
ReferenceTerms: TypeAlias = tuple[UtilityTerms, float | None, tuple[Rejection, ...]]

# Up to so many edges the choices of each task are kept: of more they fill the memory.
MAX_KEPT_EDGES = 64
# These close a host to new work only: what runs there may stay.
NEW_WORK_ONLY = (RejectionRule.CORDONED, RejectionRule.STALE, RejectionRule.NO_ENGINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateRules:
    """The part of a policy that says which hosts are weighed.

    ``edges``: whether edges may take tasks. ``robot_of`` gives the robot that a ranking lists besides a
    present host, ``reject_robot`` the rule against a robot; ``rate_affinity`` is UT_task by reward, from the
    rewards and the count of located predecessors. ``tolerant``: a running task that exceeds its present host
    by no more than the slack counts as feasible there (ADR 0061).
    """

    robot_of: Callable[[Capacities, Task], int | None]
    reject_robot: Callable[[Capacities, Task, int], Rejection | None]
    rate_affinity: Callable[[Iterable[int], int], dict[int, float]]
    edges: bool = True
    tolerant: bool = False


def find_onboard_robot(fleet: Capacities, task: Task) -> int | None:
    """The task's own robot where the inventory makes it a candidate."""
    own = find_own_robot(fleet, task)
    return own if own is not None and fleet.places[own].onboard else None


def find_first_robot(fleet: Capacities, task: Task) -> int | None:
    """The first robot of the task, whatever the inventory says of it."""
    return fleet.index.get(task.robots[0]) if task.robots else None


def find_no_robot(_fleet: Capacities, _task: Task) -> int | None:
    """None: only edges are candidates."""
    return None


def reject_by_rules(fleet: Capacities, task: Task, place: int) -> Rejection | None:
    """A robot takes its own tasks where the files allow it."""
    own = place == find_own_robot(fleet, task)
    rule = find_rule_against(fleet.places[place], task, robot=True) if own else RejectionRule.ONBOARD
    rule = rule or find_missing_engine(fleet.samples[place], task)
    return Rejection(rule=rule) if rule else fleet.closed.get(place)


def reject_other_robots(fleet: Capacities, task: Task, place: int) -> Rejection | None:
    """The first robot takes the task if it can be reached."""
    if fleet.places[place].name in task.robots[:1]:
        rule = find_missing_engine(fleet.samples[place], task)
        return Rejection(rule=rule) if rule else fleet.closed.get(place)
    return Rejection(rule=RejectionRule.ONBOARD)


def reject_every_robot(_fleet: Capacities, _task: Task, _place: int) -> Rejection | None:
    """No robot takes a task."""
    return Rejection(rule=RejectionRule.ONBOARD)


class Offer(NamedTuple):
    """What one task may choose from whatever the load, as `CandidateSet` has it."""

    task: Task
    listed: Sequence[int]
    denied: Mapping[int, Rejection]
    robots: Sequence[int]
    utilities: Mapping[int, float]
    waived: Rejection | None


@dataclass(frozen=True, slots=True, kw_only=True)
class AssignmentContext:
    """Whatever stays the same over all passes of one assignment.

    ``placement_rules``: between tasks. ``arrays``: weigh large fleets with NumPy (ADR 0076).
    ``turns``: the position of each task in the sequence, for policies that place in turn. ``ratings``:
    UT_rating, where it is weighed.
    ``edge_rejections`` caches the edges closed to a task, by its rules; ``offers`` what a task may choose
    from, by its place and those of its predecessors.
    """

    fleet: Capacities
    policy: Policy
    rules: CandidateRules
    shares: DemandShares
    now: float
    first: Mapping[str, str]
    handoffs: HandoffHistory
    placement_rules: PlacementRules = NO_RULES
    arrays: "ArrayScan | None" = None
    turns: Mapping[str, int] = field(default_factory=dict)
    ratings: Ratings = field(default_factory=dict)
    edge_rejections: dict[object, dict[int, Rejection]] = field(default_factory=dict)
    offers: dict[object, Offer] = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class CandidateSet:
    """One task against the ledger of the moment.

    ``totals`` holds eq. (4) by place (``scan.fits`` tells the feasible ones). ``listed`` are the places that
    its ranking shows, ``robots`` those of them that are no edges; ``denied`` says why a place is no
    candidate. ``predecessors`` are those with a place, ``located`` their places; ``utilities`` is UT_task by
    reward. ``placed`` counts the tasks that this pass has put on each place. ``waived`` is the rejection of
    an incumbent that is weighed all the same, because nothing else is left. ``tolerated``: the incumbent
    counts as feasible although its load exceeds it, within the slack. ``terms`` and ``uses``: the terms and
    the load of the task at the places that were asked for; so ``latencies``.
    """

    context: AssignmentContext
    ledger: Ledger
    task: Task
    incumbent: int | None
    predecessors: Mapping[str, int]
    located: Sequence[int]
    placed: Mapping[int, int]
    denied: Mapping[int, Rejection]
    listed: Sequence[int]
    robots: Sequence[int]
    utilities: Mapping[int, float]
    totals: Totals = field(default_factory=ListTotals)
    waived: Rejection | None = None
    tolerated: bool = False
    terms: dict[int, ReferenceTerms] = field(default_factory=dict, init=False)
    latencies: dict[int, PredictedLatency | None] = field(default_factory=dict, init=False)
    uses: dict[int, TaskUsage] = field(default_factory=dict, init=False)

    def name(self, place: int) -> str:
        """The name of a place."""
        return self.context.fleet.places[place].name


def gather_candidates(
    context: AssignmentContext,
    ledger: Ledger,
    task: Task,
    *,
    incumbent: int | None,
    predecessors: Mapping[str, int],
    placed: Mapping[int, int],
    stays: bool = False,
    barred: Mapping[int, Rejection] | None = None,
) -> CandidateSet:
    """``task`` against the present ledger, without the totals; its own use must already be taken out.

    ``stays``: weigh the incumbent even if it is denied. ``barred``: places that rules between tasks exclude.
    """
    located = tuple(predecessors.values())
    offer = (
        _build_offer(context, task, incumbent, located, stays=stays, barred=barred)
        if barred or stays
        else _get_offer(context, task, incumbent, located)
    )
    return CandidateSet(
        context=context,
        ledger=ledger,
        task=task,
        incumbent=incumbent,
        predecessors=predecessors,
        located=located,
        placed=placed,
        denied=offer.denied,
        listed=offer.listed,
        robots=offer.robots,
        utilities=offer.utilities,
        waived=offer.waived,
    )


def _get_offer(
    context: AssignmentContext, task: Task, incumbent: int | None, located: Sequence[int]
) -> Offer:
    """What no load decides, kept on small fleets."""
    key = task.name, incumbent, located
    known = context.offers.get(key)
    if known is None or known.task is not task:
        known = _build_offer(context, task, incumbent, located)
        if context.fleet.edges <= MAX_KEPT_EDGES:
            context.offers[key] = known
    return known


def _build_offer(
    context: AssignmentContext,
    task: Task,
    incumbent: int | None,
    located: Sequence[int],
    *,
    stays: bool = False,
    barred: Mapping[int, Rejection] | None = None,
) -> Offer:
    robots = _list_robot_places(context, task, incumbent)
    listed, denied = _list_candidates(context, task, incumbent, robots)
    if barred:
        denied = {**{place: barred[place] for place in listed if place in barred}, **denied}
    waived = denied.get(incumbent) if stays and incumbent is not None else None
    if waived is not None:
        denied = {place: rejection for place, rejection in denied.items() if place != incumbent}
    near = {place for place in located if place in listed and place not in denied}
    far = len(denied) + len(near) < len(listed)
    rewards = _collect_affinities(located, near, far=far)
    utilities = context.rules.rate_affinity(rewards, len(located))
    return Offer(task, listed, denied, robots, utilities, waived)


def weigh_candidates(candidates: CandidateSet) -> CandidateSet:
    """``candidates`` with their totals."""
    candidates.totals = _compute_place_totals(candidates)
    if not candidates.context.rules.tolerant or not _is_tolerated(candidates):
        return candidates
    candidates.totals[candidates.incumbent or 0] += INFEASIBLE_PENALTY
    candidates.tolerated = True
    return candidates


def _is_tolerated(candidates: CandidateSet) -> bool:
    """Whether the task fits on its present host with the slack, but not without."""
    here = candidates.incumbent
    if here is None or here in candidates.denied or is_feasible_total(candidates.totals[here]):
        return False
    return not find_excess(candidates, here) and not reject_missed_deadline(
        candidates.task, latency_at(candidates, here)
    )


def find_excess(candidates: CandidateSet, place: int) -> list[Resource]:
    """The resources of which the task lacks more at ``place`` than the slack, or which are missing there."""
    terms, _ = resource_terms_at(candidates, place)
    get_slack = candidates.context.fleet.get_slack
    return [
        resource
        for resource in RESOURCES
        if (term := terms[resource.name]) is None or term < -get_slack(resource, place) - EPSILON
    ]


def usage_at(candidates: CandidateSet, place: int) -> TaskUsage:
    """The load (d) of the task at one place."""
    found = candidates.uses.get(place)
    if found is None:
        found = compute_demand_usage(candidates.context.fleet, candidates.task, place)
        candidates.uses[place] = found
    return found


def latency_at(candidates: CandidateSet, place: int) -> PredictedLatency | None:
    """The predicted latency of the task at one place; None where nothing is predicted."""
    if place not in candidates.latencies:
        candidates.latencies[place] = predict_latency(candidates.ledger, candidates.task, place)
    return candidates.latencies[place]


def resource_terms_at(
    candidates: CandidateSet, place: int
) -> tuple[dict[str, float | None], tuple[Rejection, ...]]:
    """UT_k of the task at one place by resource, and what is lacking there."""
    return compute_resource_terms(candidates.ledger, candidates.task, place, usage_at(candidates, place))


def terms_at(candidates: CandidateSet, place: int) -> ReferenceTerms:
    """The reference computation of all terms, the total and what is lacking at one candidate."""
    found = candidates.terms.get(place)
    if found is None:
        found = candidates.terms[place] = _compute_reference_terms(candidates, place)
    return found


def _compute_reference_terms(candidates: CandidateSet, place: int) -> ReferenceTerms:
    values, rejections = resource_terms_at(candidates, place)
    values[AFFINITY] = candidates.utilities[compute_affinity(candidates.located, place)]
    predicted = latency_at(candidates, place)
    values[LATENCY] = rate_predicted_latency(candidates.task, predicted)
    values[RATING] = get_rating(candidates.context.ratings, candidates.task.name, place)
    rejections += reject_missed_deadline(candidates.task, predicted)
    terms = UtilityTerms.from_complete(values)
    return terms, total_utility(candidates.context.policy.weights, terms), rejections


def list_allowed_places(context: AssignmentContext, task: Task, incumbent: int | None) -> Sequence[int]:
    """The places that may take ``task``, by all rules but the room that is left there, edges first."""
    robots = _list_robot_places(context, task, incumbent)
    listed, denied = _list_candidates(context, task, incumbent, robots)
    return [place for place in listed if place not in denied] if denied else listed


def _list_robot_places(context: AssignmentContext, task: Task, incumbent: int | None) -> list[int]:
    """The robots that a ranking lists: the one that may host the task, and the one that the task runs on."""
    own = context.rules.robot_of(context.fleet, task)
    present = incumbent if incumbent is not None and incumbent >= context.fleet.edges else None
    if own is None or present is None or own == present:
        return [place for place in (own if present is None else present,) if place is not None]
    return sorted((own, present))


def _list_candidates(
    context: AssignmentContext, task: Task, incumbent: int | None, robots: Sequence[int]
) -> tuple[Sequence[int], Mapping[int, Rejection]]:
    """The places that a ranking of ``task`` lists, and the places that may not take it."""
    fleet = context.fleet
    listed: Sequence[int] = (*range(fleet.edges), *robots) if robots else range(fleet.edges)
    denied: Mapping[int, Rejection] = get_edge_rejections(context, task)
    if robots:
        denied = {
            **denied,
            **{
                place: rejection
                for place in robots
                if (rejection := context.rules.reject_robot(fleet, task, place))
            },
        }
    closed = denied.get(incumbent) if incumbent is not None else None
    if closed is not None and incumbent not in fleet.hard and closed.rule in NEW_WORK_ONLY:
        denied = {place: rejection for place, rejection in denied.items() if place != incumbent}
    return listed, denied


def get_edge_rejections(context: AssignmentContext, task: Task) -> dict[int, Rejection]:
    """Edges that may not take ``task``: by its rules, or closed to everybody."""
    rules = task.hosts
    only = task.onboard is OnboardRule.ONLY or not context.rules.edges
    labels = tuple(sorted(rules.labels.items())) if rules.labels else ()
    engine = task.image and (task.image.engine or "any")
    key = (rules.only, rules.never, labels, rules.pin, only, engine)
    if key not in context.edge_rejections:
        found = dict(context.fleet.closed)
        for edge in range(context.fleet.edges):
            rule = (
                RejectionRule.ONBOARD
                if only
                else find_rule_against(context.fleet.places[edge], task, robot=False)
                or find_missing_engine(context.fleet.samples[edge], task)
            )
            if rule is not None:
                found[edge] = Rejection(rule=rule)
        context.edge_rejections[key] = {
            edge: rejection for edge, rejection in found.items() if edge < context.fleet.edges
        }
    return context.edge_rejections[key]


def _collect_affinities(located: Sequence[int], near: set[int], *, far: bool) -> set[int]:
    """The distinct rewards among the candidates: ``near`` have a predecessor, ``far`` says whether any other
    candidate has none.
    """
    rewards = {compute_affinity(located, place) for place in near}
    return rewards | {-len(located)} if far else rewards


def _compute_place_totals(candidates: CandidateSet) -> Totals:
    """Eq. (4) at every place: the scan for the edges, the affinity on top, the reference for a robot."""
    context, task, fleet = candidates.context, candidates.task, candidates.context.fleet
    weights = context.policy.weights
    far = candidates.utilities.get(-len(candidates.located), 0.0)
    weight = weights[AFFINITY]
    row: Totals
    # A negative weight makes a huge gain of the huge shortage that stands for no capacity.
    packs = context.policy.prefer is Preference.PACK
    if context.arrays is not None and candidates.ledger.mirror is not None and not packs:
        row = context.arrays.compute_totals(candidates.ledger.mirror, task, offset=weight * far)
    else:
        totals = compute_resource_totals(
            candidates.ledger, context.shares, task, weights, offset=weight * far
        )
        if packs:
            totals = [EXCLUDED_TOTAL if total > INFEASIBLE_PENALTY else total for total in totals]
        row = ListTotals(totals)
        row.extend([EXCLUDED_TOTAL] * (len(fleet.places) - fleet.edges))
    for place in set(candidates.located):
        if place < fleet.edges and place not in candidates.denied:
            row[place] += weight * (candidates.utilities[compute_affinity(candidates.located, place)] - far)
    _add_latency(candidates, row)
    if weights[RATING]:
        for place in range(fleet.edges):
            row[place] += weights[RATING] * get_rating(context.ratings, task.name, place)
    if candidates.denied:
        row.exclude(candidates.denied)
    for place in candidates.robots:
        if place not in candidates.denied:
            row[place] = _compute_total_at(candidates, place)
    return row


def _add_latency(candidates: CandidateSet, row: Totals) -> None:
    """The latency term on top of the totals of the edges, and the penalty where a hard deadline is missed."""
    policy, task, edges = candidates.context.policy, candidates.task, candidates.context.fleet.edges
    weight = policy.weights[LATENCY]
    if is_latency_weighed(policy, task):
        for place, term, missed in list_latency_terms(candidates.ledger, task, range(edges)):
            row[place] += weight * term - INFEASIBLE_PENALTY * missed
    elif weight:
        for place in range(edges):
            row[place] += weight * NO_LATENCY_TERM


def _compute_total_at(candidates: CandidateSet, place: int) -> float:
    _, total, rejections = terms_at(candidates, place)
    return EXCLUDED_TOTAL if total is None else total - INFEASIBLE_PENALTY * bool(rejections)
