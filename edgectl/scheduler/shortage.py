# SPDX-License-Identifier: Apache-2.0
"""Shortage: what a fleet lacks, whatever the placement (ADR 0062). Pure."""

from collections.abc import Sequence
from math import fsum, inf

from edgectl.model.assignment import Shortage
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.resource import HOST_RESOURCES, Resource
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import OnboardRule, Task, Tasks
from edgectl.scheduler.capacities import Capacities, build_capacities
from edgectl.scheduler.demand import add_measured_demands
from edgectl.scheduler.feasibility import find_own_robot
from edgectl.scheduler.initial_state import InitialState, build_initial_state
from edgectl.scheduler.reservation import reserve_running_tasks
from edgectl.scheduler.utility import EPSILON


def find_shortages(inventory: Inventory, tasks: Tasks, snapshot: Snapshot) -> tuple[Shortage, ...]:
    """What the fleet of ``snapshot`` lacks for the tasks of the files."""
    manager = snapshot.manager or ManagerState()
    fleet = add_measured_demands(build_capacities(inventory, snapshot, manager, frozenset()), tasks, manager)
    state = build_initial_state(tasks, manager, fleet, snapshot.taken_at, Policy())
    return compute_shortages(reserve_running_tasks(state, tasks), tasks)


def compute_shortages(state: InitialState, tasks: Tasks) -> tuple[Shortage, ...]:
    """By resource: the expected load of the open edges, and the least demands of the tasks that wait, minus
    the capacity of these edges.

    The least that would help: tasks are not divisible, so it may take more. Without a waiting task a shortage
    within the slack is noise.
    """
    fleet = state.ledger.fleet
    edges = [edge for edge in range(fleet.edges) if edge not in fleet.closed]
    waiting = [
        task
        for task in tasks.tasks.values()
        if task.managed
        and task.name not in state.fixed
        and (task.name not in state.running or state.running[task.name].place in fleet.hard)
        and not _may_run_onboard(fleet, task)
    ]
    found = []
    for resource in HOST_RESOURCES if edges else ():
        # fsum: a sum that is rounded once does not depend on the order of the files.
        capacity = fsum(fleet.usable[resource.name][edge] for edge in edges)
        if capacity == inf:
            continue
        load = fsum(state.ledger.used[resource.name][edge] for edge in edges)
        smallest = min(fleet.raw[resource.name][edge] for edge in edges)
        wanted = fsum(_list_least_demands(fleet, waiting, resource, smallest))
        amount = load + wanted - capacity
        # Neither limit is below 0, and the slack of hundreds of edges that lack nothing is a sum for nothing.
        if amount > 0 and amount > (EPSILON if wanted else _sum_slack(fleet, resource, edges)):
            found.append(Shortage(resource=resource, amount=amount))
    return tuple(found)


def _sum_slack(fleet: Capacities, resource: Resource, edges: Sequence[int]) -> float:
    usable = fleet.usable[resource.name]
    return fsum(fleet.get_slack(resource, edge) * usable[edge] for edge in edges)


def _may_run_onboard(fleet: Capacities, task: Task) -> bool:
    own = find_own_robot(fleet, task)
    return own is not None and fleet.places[own].onboard and task.onboard is not OnboardRule.NEVER


def _list_least_demands(
    fleet: Capacities, tasks: Sequence[Task], resource: Resource, smallest: float
) -> list[float]:
    """The least that each demand can mean on any edge, as far as it is stated; a share: on one of the
    ``smallest`` capacity.
    """
    name, known = resource.name, fleet.demands
    stated = [task.demand[name] for task in tasks if task.name not in known]
    found = [quantity.of(smallest) for quantity in stated if quantity is not None]
    return found + [known[task.name].find_least(name, smallest) for task in tasks if task.name in known]
