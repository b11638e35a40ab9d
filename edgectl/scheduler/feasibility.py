"""Feasibility: the hosts that may run a task, and those where it fits.

A rejection is a record, never a log line.
"""

from collections.abc import Mapping

from edgectl.model.assignment import Rejection, RejectionRule
from edgectl.model.inventory import Host
from edgectl.model.resource import NETWORK, RESOURCES, Resource
from edgectl.model.task import OnboardRule, Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.ledger import Ledger, compute_demand_usage
from edgectl.scheduler.utility import EPSILON, resource_utility


def find_own_robot(fleet: Capacities, task: Task) -> int | None:
    """The place of the task's robot where it has exactly one."""
    return fleet.index.get(task.robots[0]) if len(task.robots) == 1 else None


def find_rule_against(host: Host, task: Task, *, robot: bool) -> RejectionRule | None:
    """The rule of the task file that keeps ``task`` off ``host``.

    ``robot``: the host is the task's own robot.
    """
    rules = task.hosts
    if robot and (task.onboard is OnboardRule.NEVER or not host.onboard):
        return RejectionRule.ONBOARD
    if not robot and task.onboard is OnboardRule.ONLY:
        return RejectionRule.ONBOARD
    if rules.pin is not None and host.name != rules.pin:
        return RejectionRule.PIN
    if rules.only and host.name not in rules.only:
        return RejectionRule.NOT_ONLY
    if host.name in rules.never:
        return RejectionRule.NEVER
    return (
        RejectionRule.LABELS
        if any(host.labels.get(key) != value for key, value in rules.labels.items())
        else None
    )


def compute_resource_terms(
    ledger: Ledger, task: Task, place: int
) -> tuple[dict[str, float | None], tuple[Rejection, ...]]:
    """UT_k of one task at one place by resource (None without capacity), and the rejections for what it lacks
    there: the reference form of eqs. (1)-(3).

    ``scan`` computes the same for all edges at once.
    """
    fleet = ledger.fleet
    use = compute_demand_usage(fleet, task, place)
    terms: dict[str, float | None] = {}
    rejections: tuple[Rejection, ...] = ()
    for resource in RESOURCES:
        name = resource.name
        if resource.per_link:
            term, lacking = _compute_network_term(ledger, task, place, use.links)
        else:
            term, lacking = _compute_term(
                resource, fleet.usable[name][place], ledger.used[name][place], use.used[name]
            )
        terms[name] = term
        rejections += lacking
    return terms, rejections


def _compute_term(
    resource: Resource, capacity: float, used: float, demand: float, robot: str | None = None
) -> tuple[float | None, tuple[Rejection, ...]]:
    utility = resource_utility(capacity, used, demand) if capacity > 0 else None
    if utility is not None and utility >= -EPSILON:
        return utility, ()
    rule = RejectionRule.NO_CAPACITY if utility is None else RejectionRule.INSUFFICIENT
    return utility, (
        Rejection(rule=rule, resource=resource, robot=robot, demand=demand, used=used, capacity=capacity),
    )


def _compute_network_term(
    ledger: Ledger, task: Task, place: int, rates: Mapping[str, float]
) -> tuple[float | None, tuple[Rejection, ...]]:
    """UT_net, eq. (3): the worst of the task's links; 1 onboard or without a robot."""
    if place >= ledger.fleet.edges:
        return 1.0, ()
    worst: float | None = 1.0
    rejections: tuple[Rejection, ...] = ()
    for robot in task.robots:
        term, lack = _compute_link_term(ledger, robot, place, rates.get(robot, 0.0))
        worst = None if worst is None or term is None else min(worst, term)
        rejections += lack
    return worst, rejections


def _compute_link_term(
    ledger: Ledger, robot: str, place: int, rate: float
) -> tuple[float | None, tuple[Rejection, ...]]:
    capacity = ledger.fleet.links[robot][place] if robot in ledger.fleet.links else None
    if capacity is None:
        return None, (Rejection(rule=RejectionRule.NO_LINK, resource=NETWORK, robot=robot),)
    return _compute_term(NETWORK, capacity, ledger.links[robot][place], rate, robot)
