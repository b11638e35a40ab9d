"""One task looked at from every place: who is a candidate, and each candidate's total (DESIGN 5.5-5.7)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from edgectl.model.assignment import Rejection, RejectionRule, Terms
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import OnboardRule, Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.feasibility import compute_resource_terms, find_own_robot, find_rule_against
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.move_cost import HandoffHistory
from edgectl.scheduler.scan import EXCLUDED_TOTAL, INFEASIBLE_PENALTY, DemandShares, compute_resource_totals
from edgectl.scheduler.utility import compute_affinity, paper_task_utilities, task_utilities, total_utility

# These close a host to new work only: what runs there may stay.
_NEW_WORK_ONLY = (RejectionRule.CORDONED, RejectionRule.STALE)


@dataclass(frozen=True, slots=True, kw_only=True)
class AssignmentContext:
    """What stays the same over all passes of one assignment. ``barred`` caches the edges closed to a task, by its rules."""

    fleet: Capacities
    policy: Policy
    shares: DemandShares
    now: float
    first: Mapping[str, str]
    handoffs: HandoffHistory
    edge_rejections: dict[object, dict[int, Rejection]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateSet:
    """One task against the ledger of the moment.

    ``totals`` holds eq. (4) by place (``scan.fits`` tells the feasible ones). ``listed`` are the places that its ranking shows,
    ``robots`` those of them that are no edges; ``denied`` says why a place is no candidate. ``predecessors`` are those with a place,
    ``located`` their places; ``utilities`` is UT_task by reward. ``placed`` counts the tasks that this pass has put on each place.
    ``waived`` is the rejection of an incumbent that is weighed all the same, because nothing else is left.
    """

    setting: AssignmentContext
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
    totals: list[float]
    waived: Rejection | None = None

    def name(self, place: int) -> str:
        """The name of a place."""
        return self.setting.fleet.places[place].name


def evaluate_candidates(
    setting: AssignmentContext, ledger: Ledger, task: Task, *, incumbent: int | None, predecessors: Mapping[str, int], placed: Mapping[int, int],
    stays: bool = False,
) -> CandidateSet:  # fmt: skip
    """``task`` against the present ledger; its own use must already be taken out. ``stays``: weigh the incumbent even if it is denied."""
    located = tuple(predecessors.values())
    robots = _list_robot_places(setting, task, incumbent)
    listed, denied = _list_candidates(setting, task, incumbent, robots)
    waived = denied.get(incumbent) if stays and incumbent is not None else None
    if waived is not None:
        denied = {place: rejection for place, rejection in denied.items() if place != incumbent}
    near = {place for place in located if place in listed and place not in denied}
    far = any(place not in denied and place not in near for place in listed)
    rewards = _collect_affinities(located, near, far=far)
    utilities = (
        paper_task_utilities(rewards, len(located))
        if setting.policy.name is PolicyName.PAPER
        else task_utilities(rewards)
    )
    view = CandidateSet(
        setting=setting, ledger=ledger, task=task, incumbent=incumbent, predecessors=predecessors,
        located=located, placed=placed, denied=denied, listed=listed, robots=robots, utilities=utilities, totals=[], waived=waived,
    )  # fmt: skip
    view.totals.extend(_compute_place_totals(view))
    return view


def terms_at(view: CandidateSet, place: int) -> tuple[Terms, float | None, tuple[Rejection, ...]]:
    """The reference computation of all four terms, the total and what is lacking at one candidate."""
    reading = compute_resource_terms(view.ledger, view.task, place)
    task = view.utilities[compute_affinity(view.located, place)]
    terms = Terms(cpu=reading.cpu, memory=reading.memory, network=reading.network, task=task)
    return terms, total_utility(view.setting.policy.weights, terms), reading.rejections


def _list_robot_places(setting: AssignmentContext, task: Task, incumbent: int | None) -> list[int]:
    """The robots that a ranking lists: the task's own where it may be a host, and one that the task runs on."""
    fleet, policy = setting.fleet, setting.policy.name
    own = (
        fleet.index.get(task.robots[0])
        if policy is PolicyName.LOCAL and task.robots
        else find_own_robot(fleet, task)
    )
    wanted = own is not None and (
        policy is PolicyName.LOCAL or (fleet.places[own].onboard and policy is not PolicyName.PAPER)
    )
    robots = {own} if own is not None and wanted else set()
    return sorted(robots | ({incumbent} if incumbent is not None and incumbent >= fleet.edges else set()))


def _list_candidates(
    setting: AssignmentContext, task: Task, incumbent: int | None, robots: Sequence[int]
) -> tuple[Sequence[int], Mapping[int, Rejection]]:
    """The places that a ranking of ``task`` lists, and the places that may not take it."""
    fleet = setting.fleet
    listed: Sequence[int] = (*range(fleet.edges), *robots) if robots else range(fleet.edges)
    denied: Mapping[int, Rejection] = _get_edge_rejections(setting, task)
    if robots:
        denied = {
            **denied,
            **{
                place: rejection
                for place in robots
                if (rejection := _find_robot_rejection(setting, task, place))
            },
        }
    closed = denied.get(incumbent) if incumbent is not None else None
    if closed is not None and incumbent not in fleet.hard and closed.rule in _NEW_WORK_ONLY:
        denied = {place: rejection for place, rejection in denied.items() if place != incumbent}
    return listed, denied


def _find_robot_rejection(setting: AssignmentContext, task: Task, place: int) -> Rejection | None:
    """Why a robot may not take ``task``; policy local asks only whether it can be reached."""
    fleet = setting.fleet
    if setting.policy.name is PolicyName.LOCAL:
        return (
            fleet.closed.get(place)
            if fleet.places[place].name in task.robots[:1]
            else Rejection(rule=RejectionRule.ONBOARD)
        )
    own = place == find_own_robot(fleet, task) and setting.policy.name is not PolicyName.PAPER
    rule = find_rule_against(fleet.places[place], task, robot=True) if own else RejectionRule.ONBOARD
    return Rejection(rule=rule) if rule else fleet.closed.get(place)


def _get_edge_rejections(setting: AssignmentContext, task: Task) -> dict[int, Rejection]:
    """Edges that may not take ``task``: by its rules, or closed to everybody."""
    rules = task.hosts
    only = task.onboard is OnboardRule.ONLY or setting.policy.name is PolicyName.LOCAL
    key = (rules.only, rules.never, tuple(sorted(rules.labels.items())), rules.pin, only)
    if key not in setting.edge_rejections:
        found = dict(setting.fleet.closed)
        for edge in range(setting.fleet.edges):
            rule = (
                RejectionRule.ONBOARD
                if only
                else find_rule_against(setting.fleet.places[edge], task, robot=False)
            )
            if rule is not None:
                found[edge] = Rejection(rule=rule)
        setting.edge_rejections[key] = {
            edge: rejection for edge, rejection in found.items() if edge < setting.fleet.edges
        }
    return setting.edge_rejections[key]


def _collect_affinities(located: Sequence[int], near: set[int], *, far: bool) -> set[int]:
    """The distinct rewards among the candidates: ``near`` have a predecessor, ``far`` says whether any other candidate has none."""
    rewards = {compute_affinity(located, place) for place in near}
    return rewards | {-len(located)} if far else rewards


def _compute_place_totals(view: CandidateSet) -> list[float]:
    """Eq. (4) at every place: the scan for the edges, the affinity on top, the reference for a robot."""
    setting, task, fleet = view.setting, view.task, view.setting.fleet
    weights = setting.policy.weights
    far = view.utilities.get(-len(view.located), 0.0)
    row = compute_resource_totals(view.ledger, setting.shares, task, weights, offset=weights.task * far)
    row.extend([EXCLUDED_TOTAL] * (len(fleet.places) - fleet.edges))
    for place in set(view.located):
        if place < fleet.edges and place not in view.denied:
            row[place] += weights.task * (view.utilities[compute_affinity(view.located, place)] - far)
    for place in view.denied:
        row[place] = EXCLUDED_TOTAL
    for place in view.robots:
        if place not in view.denied:
            row[place] = _compute_total_at(view, place)
    return row


def _compute_total_at(view: CandidateSet, place: int) -> float:
    _, total, rejections = terms_at(view, place)
    return EXCLUDED_TOTAL if total is None else total - INFEASIBLE_PENALTY * bool(rejections)
