"""Who may run a task at all, and where it fits (DESIGN 5.4, 5.5). A rejection is a record, never a log line."""

from typing import NamedTuple

from edgectl.model.assignment import Rejection, Resource, Rule
from edgectl.model.inventory import Host
from edgectl.model.task import ZERO, Onboard, Quantity, Task
from edgectl.scheduler.fleet import Fleet
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.rho import demand_at
from edgectl.scheduler.utility import EPSILON, resource_utility


class Reading(NamedTuple):
    """UT_cpu, UT_mem and UT_net of one task at one place (None without capacity), and what it lacks there."""

    cpu: float | None
    memory: float | None
    network: float | None
    rejections: tuple[Rejection, ...]


def own_robot(fleet: Fleet, task: Task) -> int | None:
    """The place of the task's robot where it has exactly one."""
    return fleet.index.get(task.robots[0]) if len(task.robots) == 1 else None


def rule_against(host: Host, task: Task, *, robot: bool) -> Rule | None:
    """Which rule of the task file keeps ``task`` off ``host``; ``robot``: the host is the task's own robot."""
    rules = task.hosts
    if robot and (task.onboard is Onboard.NEVER or not host.onboard):
        return Rule.ONBOARD
    if not robot and task.onboard is Onboard.ONLY:
        return Rule.ONBOARD
    if rules.pin is not None and host.name != rules.pin:
        return Rule.PIN
    if rules.only and host.name not in rules.only:
        return Rule.NOT_ONLY
    if host.name in rules.never:
        return Rule.NEVER
    return Rule.LABELS if any(host.labels.get(key) != value for key, value in rules.labels.items()) else None


def read(ledger: Ledger, task: Task, place: int) -> Reading:
    """The reference form of eqs. (1)-(3) for one task at one place; ``scan`` computes the same for all edges at once."""
    fleet = ledger.fleet
    wanted = demand_at(fleet, task, place)
    cpu, cpu_lack = _term(Resource.CPU, fleet.cpu[place], ledger.cpu[place], (wanted.cpu or ZERO).of(fleet.raw_cpu[place]))
    memory, memory_lack = _term(
        Resource.MEMORY, fleet.memory[place], ledger.memory[place], (wanted.memory or ZERO).of(fleet.raw_memory[place])
    )
    network, network_lack = _network(ledger, task, place, wanted.throughput or ZERO)
    return Reading(cpu, memory, network, cpu_lack + memory_lack + network_lack)


def _term(
    resource: Resource, capacity: float, used: float, wanted: float, robot: str | None = None
) -> tuple[float | None, tuple[Rejection, ...]]:
    utility = resource_utility(capacity, used, wanted) if capacity > 0 else None
    if utility is not None and utility >= -EPSILON:
        return utility, ()
    rule = Rule.NO_CAPACITY if utility is None else Rule.INSUFFICIENT
    return utility, (Rejection(rule=rule, resource=resource, robot=robot, demand=wanted, used=used, capacity=capacity),)


def _network(ledger: Ledger, task: Task, place: int, throughput: Quantity) -> tuple[float | None, tuple[Rejection, ...]]:
    """UT_net, eq. (3): the worst of the task's links; 1 onboard or without a robot."""
    if place >= ledger.fleet.edges:
        return 1.0, ()
    worst: float | None = 1.0
    rejections: tuple[Rejection, ...] = ()
    for robot in task.robots:
        term, lack = _link(ledger, robot, place, throughput)
        worst = None if worst is None or term is None else min(worst, term)
        rejections += lack
    return worst, rejections


def _link(ledger: Ledger, robot: str, place: int, throughput: Quantity) -> tuple[float | None, tuple[Rejection, ...]]:
    capacity = ledger.fleet.links[robot][place] if robot in ledger.fleet.links else None
    if capacity is None:
        return None, (Rejection(rule=Rule.NO_LINK, resource=Resource.NETWORK, robot=robot),)
    return _term(Resource.NETWORK, capacity, ledger.links[robot][place], throughput.of(capacity), robot)
