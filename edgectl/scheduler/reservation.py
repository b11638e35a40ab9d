# SPDX-License-Identifier: Apache-2.0
"""Reservations (ADR 0060): what a running task counts for, where it is and wherever it may go. Pure.

The accounting of the scheduler is this, for greedy passes and for everything that changes their result:

- ``ledger.Ledger``: gamma of every place and link; ``charge`` and ``release`` a `TaskUsage`.
- ``ledger.compute_demand_usage``: d, the load of a task at a place: its demand, or what it was measured to
  use if it runs and that is more. Terms, feasibility and charges all use it.
- ``can_hold``: whether a place holds such a load.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from edgectl.model.demand import ZERO, Quantity
from edgectl.model.resource import NETWORK, RESOURCES_BY_NAME
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.initial_state import InitialState, RunningTask
from edgectl.scheduler.ledger import Ledger, compute_demand_usage, compute_free_share
from edgectl.scheduler.task_usage import TaskUsage
from edgectl.scheduler.utility import EPSILON


def reserve_running_tasks(state: InitialState, tasks: Tasks) -> InitialState:
    """The initial state in which each running task of the plan counts for what it reserves:
    r = max(demand, measured usage), in place of its measured usage.
    """
    resident = {**state.held, **state.running}
    measured = state.ledger.fleet
    fleet = replace(measured, floors=dict(_list_floors(measured, tasks, resident)))
    ledger = state.ledger.copy()
    ledger.fleet = fleet
    for there in resident.values():
        ledger.release(there.place, there.use)
    reserved = {
        name: RunningTask(
            place=there.place,
            use=compute_demand_usage(fleet, tasks.tasks[name], there.place),
            since=there.since,
            counts=there.counts,
            sample=there.sample,
        )
        for name, there in sorted(resident.items())
    }
    for there in reserved.values():
        ledger.charge(there.place, there.use)
    return replace(
        state,
        ledger=ledger,
        running={name: reserved[name] for name in state.running},
        held={name: reserved[name] for name in state.held},
    )


def can_hold(ledger: Ledger, place: int, use: TaskUsage) -> bool:
    """Whether ``place`` holds ``use`` besides its present load: every term of it is 0 or more."""
    return all(share >= -EPSILON for share in _list_shares_left(ledger, place, use))


def _list_shares_left(ledger: Ledger, place: int, use: TaskUsage) -> Iterator[float]:
    """(Delta - gamma - d) / Delta of every resource that ``use`` names."""
    fleet = ledger.fleet
    for name, amount in use.used.items():
        yield compute_free_share(fleet.usable[name][place], ledger.used[name][place] + amount)
    for robot, rate in use.links.items():
        yield compute_free_share(fleet.links[robot][place], ledger.links[robot][place] + rate)


def _list_floors(
    fleet: Capacities, tasks: Tasks, resident: Mapping[str, RunningTask]
) -> Iterator[tuple[str, TaskUsage]]:
    """By task, the measured usage below which its demand does not count, where that decides anywhere."""
    for name, there in resident.items():
        least = _list_least_demands(fleet, tasks.tasks[name]) if there.counts else {}
        used = {
            resource: amount
            for resource, amount in there.use.used.items()
            if resource in least and not RESOURCES_BY_NAME[resource].optional and amount > least[resource]
        }
        links = (
            {
                robot: rate
                for robot, rate in there.use.links.items()
                if rate > (least[NETWORK.name] if robot in tasks.tasks[name].robots else 0.0)
            }
            if there.counts
            else {}
        )
        if used or links:
            yield name, TaskUsage(used=used, links=links)


def _list_least_demands(fleet: Capacities, task: Task) -> dict[str, float]:
    """The least that each demand of ``task`` can mean at any place."""
    known = fleet.demands.get(task.name)
    demands = [task.demand] if known is None else known.list_all()
    return {name: min(_get_least(demand[name] or ZERO) for demand in demands) for name in RESOURCES_BY_NAME}


def _get_least(quantity: Quantity) -> float:
    """A share may mean next to nothing on a small host."""
    return 0.0 if quantity.relative else quantity.value
