"""Feasibility: the hosts that may run a task, and those where it fits.

A rejection is a record, never a log line.
"""

from typing import NamedTuple

from edgectl.model.assignment import Rejection, RejectionRule
from edgectl.model.inventory import Host
from edgectl.model.resource import NETWORK, RESOURCES, Resource
from edgectl.model.task import ZERO, OnboardRule, Quantity, Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.demand import demand_at
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.utility import EPSILON, resource_utility


class ResourceTerms(NamedTuple):
    """UT_k of one task at one place in the order of the table (None without capacity), and the rejections for
    what it lacks there.
    """

    terms: list[float | None]
    rejections: tuple[Rejection, ...]


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


def compute_resource_terms(ledger: Ledger, task: Task, place: int) -> ResourceTerms:
    """The reference form of eqs. (1)-(3) for one task at one place.

    ``scan`` computes the same for all edges at once.
    """
    fleet = ledger.fleet
    demand = demand_at(fleet, task, place)
    terms: list[float | None] = []
    rejections: tuple[Rejection, ...] = ()
    for resource in RESOURCES:
        name = resource.name
        quantity = demand[name] or ZERO
        if resource.per_link:
            term, lacking = _compute_network_term(ledger, task, place, quantity)
        else:
            amount = quantity.of(fleet.raw[name][place])
            term, lacking = _compute_term(
                resource, fleet.usable[name][place], ledger.used[name][place], amount
            )
        terms.append(term)
        rejections += lacking
    return ResourceTerms(terms, rejections)


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
    ledger: Ledger, task: Task, place: int, throughput: Quantity
) -> tuple[float | None, tuple[Rejection, ...]]:
    """UT_net, eq. (3): the worst of the task's links; 1 onboard or without a robot."""
    if place >= ledger.fleet.edges:
        return 1.0, ()
    worst: float | None = 1.0
    rejections: tuple[Rejection, ...] = ()
    for robot in task.robots:
        term, lack = _compute_link_term(ledger, robot, place, throughput)
        worst = None if worst is None or term is None else min(worst, term)
        rejections += lack
    return worst, rejections


def _compute_link_term(
    ledger: Ledger, robot: str, place: int, throughput: Quantity
) -> tuple[float | None, tuple[Rejection, ...]]:
    capacity = ledger.fleet.links[robot][place] if robot in ledger.fleet.links else None
    if capacity is None:
        return None, (Rejection(rule=RejectionRule.NO_LINK, resource=NETWORK, robot=robot),)
    return _compute_term(NETWORK, capacity, ledger.links[robot][place], throughput.of(capacity), robot)
