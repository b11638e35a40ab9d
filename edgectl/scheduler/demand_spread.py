# SPDX-License-Identifier: Apache-2.0
"""Percent demands that mean different amounts on unlike hosts: the paper's form, seldom intended."""

from collections.abc import Iterator, Sequence
from math import inf

from edgectl.model.assignment import DemandSpread
from edgectl.model.demand import Quantity
from edgectl.model.resource import HOST_RESOURCES, NETWORK, Resource
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.feasibility import find_own_robot, find_rule_against

# Capacities further apart than this (greatest over least) are unlike.
MAX_CAPACITY_RATIO = 1.25


def find_demand_spreads(fleet: Capacities, tasks: Tasks) -> tuple[DemandSpread, ...]:
    """The percent demands whose meaning differs among the hosts that may run the task: one per entry of the
    file and resource.
    """
    entries: dict[str, Task] = {}
    for name in sorted(tasks.tasks):
        task = tasks.tasks[name]
        percent = [key for key, each in task.demand.items() if each is not None and each.relative]
        if task.managed and percent not in ([], [NETWORK.name]):
            entries.setdefault(task.template, task)
    return tuple(found for task in entries.values() for found in _find_task_spreads(fleet, task))


def _find_task_spreads(fleet: Capacities, task: Task) -> Iterator[DemandSpread]:
    places = _list_allowed_places(fleet, task)
    for resource in HOST_RESOURCES:
        quantity, raw = task.demand[resource.name], fleet.raw[resource.name]
        if (
            quantity is not None
            and quantity.relative
            and not (quantity.measured and task.name in fleet.demands)
        ):
            yield from _find_resource_spread(
                fleet,
                task,
                resource,
                quantity,
                [(place, raw[place]) for place in places if 0 < raw[place] < inf],
            )


def _find_resource_spread(
    fleet: Capacities,
    task: Task,
    resource: Resource,
    quantity: Quantity,
    capacities: Sequence[tuple[int, float]],
) -> Iterator[DemandSpread]:
    if not capacities:
        return
    ordered = sorted(capacities, key=lambda each: (each[1], fleet.order[each[0]]))
    (small, least), (large, most) = ordered[0], ordered[-1]
    if most > MAX_CAPACITY_RATIO * least:
        yield DemandSpread(
            task=task.template,
            resource=resource,
            share=quantity.value,
            least=quantity.of(least),
            most=quantity.of(most),
            hosts=(fleet.places[small].name, fleet.places[large].name),
        )


def _list_allowed_places(fleet: Capacities, task: Task) -> list[int]:
    """Places where the rules of the file let ``task`` run, closed for the moment or not."""
    own = find_own_robot(fleet, task)
    robots = (
        [own] if own is not None and find_rule_against(fleet.places[own], task, robot=True) is None else []
    )
    return [
        edge
        for edge in range(fleet.edges)
        if find_rule_against(fleet.places[edge], task, robot=False) is None
    ] + robots
