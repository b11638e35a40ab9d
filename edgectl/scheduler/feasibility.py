# SPDX-License-Identifier: Apache-2.0
"""Feasibility: the hosts that may run a task, and those where it fits.

A rejection is a record, never a log line.
"""

from collections.abc import Mapping

from edgectl.model.assignment import Rejection, RejectionRule
from edgectl.model.inventory import Host
from edgectl.model.resource import NETWORK, NOTHING, RESOURCES, Resource
from edgectl.model.snapshot import HostSample
from edgectl.model.task import OnboardRule, Task
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.ledger import Ledger, compute_demand_usage
from edgectl.scheduler.task_usage import TaskUsage
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


def find_missing_engine(sample: HostSample | None, task: Task) -> RejectionRule | None:
    """The rule against a host that cannot run the container of ``task``; None where it can, or may."""
    if task.image is None or sample is None or sample.engines is None:
        return None
    wanted = task.image.engine
    found = bool(sample.engines) if wanted is None else wanted.value in sample.engines
    return None if found else RejectionRule.NO_ENGINE


def compute_resource_terms(
    ledger: Ledger, task: Task, place: int, use: TaskUsage | None = None
) -> tuple[dict[str, float | None], tuple[Rejection, ...]]:
    """UT_k of one task at one place by resource (None without capacity), and the rejections for what it lacks
    there: the reference form of eqs. (1)-(3).

    ``use``: what the task counts for there, where that is known. ``scan`` computes the same for all edges at
    once.
    """
    fleet = ledger.fleet
    use = compute_demand_usage(fleet, task, place) if use is None else use
    terms: dict[str, float | None] = {}
    rejections: list[Rejection] = []
    for resource in RESOURCES:
        name = resource.name
        terms[name] = (
            _compute_network_term(ledger, task, place, use.links, rejections)
            if resource.per_link
            else _compute_term(
                resource, fleet.usable[name][place], ledger.used[name][place], use.used[name], rejections
            )
        )
    return terms, tuple(rejections)


def _compute_term(
    resource: Resource,
    capacity: float,
    used: float,
    demand: float,
    rejections: list[Rejection],
    robot: str | None = None,
) -> float | None:
    """One term; a shortage is added to ``rejections``."""
    if capacity == NOTHING:
        utility, capacity = (None, 0.0) if demand > 0 else (1.0, capacity)
    else:
        utility = resource_utility(capacity, used, demand) if capacity > 0 else None
    if utility is None or utility < -EPSILON:
        rule = RejectionRule.NO_CAPACITY if utility is None else RejectionRule.INSUFFICIENT
        rejections.append(
            Rejection(rule=rule, resource=resource, robot=robot, demand=demand, used=used, capacity=capacity)
        )
    return utility


def _compute_network_term(
    ledger: Ledger, task: Task, place: int, rates: Mapping[str, float], rejections: list[Rejection]
) -> float | None:
    """UT_net, eq. (3): the worst of the task's links; 1 onboard or without a robot."""
    worst: float | None = 1.0
    for robot in task.robots if place < ledger.fleet.edges else ():
        row = ledger.fleet.links.get(robot)
        capacity = None if row is None else row[place]
        if capacity is None:
            rejections.append(Rejection(rule=RejectionRule.NO_LINK, resource=NETWORK, robot=robot))
            worst = None
            continue
        used, rate = ledger.links[robot][place], rates.get(robot, 0.0)
        term = _compute_term(NETWORK, capacity, used, rate, rejections, robot)
        worst = None if worst is None or term is None else min(worst, term)
    return worst
