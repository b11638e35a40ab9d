# SPDX-License-Identifier: Apache-2.0
"""Demand (rho) of a task on one host (ADR 0025): declared, or measured on that class of hosts."""

from dataclasses import replace

from edgectl.model.assignment import DemandSource, ResourceDemand
from edgectl.model.demand import ZERO, Demand, Quantity
from edgectl.model.manager_state import ManagerState, MeasuredDemand
from edgectl.model.resource import CPU, MEMORY, RESOURCES, Resource
from edgectl.model.task import Task, Tasks
from edgectl.rules.measured_demand import (
    classify_host,
    estimate_demand,
    has_enough_samples,
    is_of_current_spec,
    resolve_demand,
)
from edgectl.scheduler.capacities import Capacities

# In place of a class without enough history.
OTHER_CLASS = ""


def add_measured_demands(fleet: Capacities, tasks: Tasks, manager: ManagerState) -> Capacities:
    """The fleet with the demands that ``manager`` has measured; nothing is done where there are none."""
    if not manager.measured:
        return fleet
    known: dict[str, dict[str, MeasuredDemand]] = {}
    history = {
        key: found
        for key, found in manager.measured.items()
        if key[0] in tasks.tasks and is_of_current_spec(tasks.tasks[key[0]], found)
    }
    for (task, kind), found in history.items():
        if has_enough_samples(found):
            known.setdefault(task, {})[kind] = found
    demands = {
        task: _resolve_demand_by_class(tasks.tasks[task].demand, found) for task, found in known.items()
    }
    classes = tuple(
        classify_host(host, cores, total) if cores > 0 and total > 0 else OTHER_CLASS
        for host, cores, total in zip(fleet.places, fleet.raw[CPU.name], fleet.raw[MEMORY.name], strict=True)
    )
    return replace(fleet, classes=classes, demands=demands, history=history)


def _resolve_demand_by_class(stated: Demand, known: dict[str, MeasuredDemand]) -> dict[str, Demand]:
    return {kind: resolve_demand(stated, found) for kind, found in known.items()} | {
        OTHER_CLASS: estimate_demand(stated, known.values())
    }


def demand_at(fleet: Capacities, task: Task, place: int) -> Demand:
    """The demand of ``task`` at ``place``."""
    own = fleet.demands.get(task.name)
    if own is None:
        return task.demand
    return own.get(fleet.classes[place]) or own[OTHER_CLASS]


def list_resource_demands(fleet: Capacities, task: Task, place: int) -> tuple[ResourceDemand, ...]:
    """What ``task`` counts for at ``place`` in absolute numbers, and where its demands come from."""
    counted = demand_at(fleet, task, place)
    return tuple(
        _raise_to_usage(
            fleet,
            task,
            _build_resource_demand(
                fleet, task, place, resource, (task.demand[resource.name], counted[resource.name]), capacity
            ),
        )
        for resource in RESOURCES
        if (capacity := _find_capacity(fleet, task, place, resource)) is not None
    )


def _raise_to_usage(fleet: Capacities, task: Task, rho: ResourceDemand) -> ResourceDemand:
    """The demand, or the measured usage that counts in its place because it is more (ADR 0060)."""
    floor = fleet.floors.get(task.name)
    if floor is None:
        return rho
    used = (
        max((floor.links.get(robot, 0.0) for robot in task.robots), default=0.0)
        if rho.resource.per_link
        else floor.used.get(rho.resource.name, 0.0)
    )
    return replace(rho, value=used, demanded=rho.value) if used > rho.value else rho


def _find_capacity(fleet: Capacities, task: Task, place: int, resource: Resource) -> float | None:
    """The capacity that a share of ``resource`` is of: the host's before limits, or the task's largest link.

    None without a link.
    """
    if not resource.per_link:
        return fleet.raw[resource.name][place]
    if place >= fleet.edges:
        return None
    links = (fleet.nominal_links[robot][place] for robot in task.robots if robot in fleet.links)
    return max((link for link in links if link is not None), default=None)


def _build_resource_demand(
    fleet: Capacities,
    task: Task,
    place: int,
    resource: Resource,
    quantities: tuple[Quantity | None, Quantity | None],
    capacity: float,
) -> ResourceDemand:
    """``quantities``: as stated, and as it counts at ``place``."""
    stated, counted = quantities
    value = (counted or ZERO).of(capacity)
    if resource.optional or (stated is not None and not stated.measured):
        return ResourceDemand(resource=resource, value=value, source=DemandSource.DECLARED)
    history = fleet.history.get((task.name, fleet.classes[place])) if fleet.classes else None
    return ResourceDemand(
        resource=resource,
        value=value,
        source=_find_demand_source(fleet, task, place, stated, counted),
        samples=history.samples if history else 0,
    )


def _find_demand_source(
    fleet: Capacities, task: Task, place: int, stated: Quantity | None, counted: Quantity | None
) -> DemandSource:
    if counted is not stated and counted is not None:
        here = fleet.classes[place] in fleet.demands[task.name]
        return DemandSource.MEASURED if here else DemandSource.MEASURED_ELSEWHERE
    return DemandSource.DECLARED if stated is not None and stated.value > 0 else DemandSource.NONE
