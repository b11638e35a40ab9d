# SPDX-License-Identifier: Apache-2.0
"""Demand (rho) of a task on one host (ADR 0025): declared, or measured on that class of hosts."""

from collections.abc import Iterable, Mapping
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

# In place of the class of a host without capacity.
OTHER_CLASS = ""


class ClassDemands:
    """Demand (rho) of one task whose history decides it, by class of hosts, each resolved when it is first
    read: a large plan asks only for numbers (ADR 147).

    ``stated``: of the file; ``known``: what was measured, by the classes with enough history.
    """

    __slots__ = ("_follows", "_made", "known", "stated")

    def __init__(self, stated: Demand, known: Mapping[str, MeasuredDemand]) -> None:
        self.stated, self.known = stated, known
        self._follows = not any(stated.values())  # of None and quantities, none of which is false
        self._made: dict[str | None, Demand] = {}

    def at(self, kind: str) -> Demand:
        """The demand on hosts of class ``kind``."""
        found = self._made.get(kind)
        if found is None:
            measured = self.known.get(kind)
            found = self._made[kind] = (
                self.elsewhere if measured is None else resolve_demand(self.stated, measured)
            )
        return found

    @property
    def elsewhere(self) -> Demand:
        """The demand on hosts of a class without enough history."""
        found = self._made.get(None)
        if found is None:
            found = self._made[None] = estimate_demand(self.stated, self.known.values())
        return found

    def list_all(self) -> list[Demand]:
        """The demands on all classes, those without history too."""
        return [*map(self.at, self.known), self.elsewhere]

    def list_quantities(self, kind: str, resources: Iterable[str]) -> list[Quantity]:
        """The demand of each of ``resources`` on hosts of class ``kind``."""
        demand = self.at(kind)
        return [demand[resource] or ZERO for resource in resources]

    def get_measured(self, kind: str) -> Mapping[str, float]:
        """The amounts by resource that are as measured on hosts of class ``kind``, where all of them are."""
        measured = self.known.get(kind) if self._follows else None
        return {} if measured is None else measured.used

    def find_least(self, resource: str, capacity: float) -> float:
        """The least that the demand means on a host with ``capacity`` of ``resource``, whatever its class."""
        values = [found.used[resource] for found in self.known.values() if resource in found.used]
        if not values:
            return (self.stated[resource] or ZERO).of(capacity)  # as on every class
        if self._follows and len(values) == len(self.known):
            return min(values)  # elsewhere the greatest counts
        return min((demand[resource] or ZERO).of(capacity) for demand in self.list_all())


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
    demands = {task: ClassDemands(tasks.tasks[task].demand, found) for task, found in known.items()}
    classes = tuple(
        classify_host(host, cores, total) if cores > 0 and total > 0 else OTHER_CLASS
        for host, cores, total in zip(fleet.places, fleet.raw[CPU.name], fleet.raw[MEMORY.name], strict=True)
    )
    return replace(fleet, classes=classes, demands=demands, history=history)


def demand_at(fleet: Capacities, task: Task, place: int) -> Demand:
    """The demand of ``task`` at ``place``."""
    own = fleet.demands.get(task.name)
    if own is None:
        return task.demand
    return own.at(fleet.classes[place])


def list_resource_demands(fleet: Capacities, task: Task, place: int) -> tuple[ResourceDemand, ...]:
    """What ``task`` counts for at ``place`` in absolute numbers, and where its demands come from.

    Of the optional resources only those that it demands: few tasks do.
    """
    counted = demand_at(fleet, task, place)
    found = (
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
    return tuple(rho for rho in found if rho.value or not rho.resource.optional)


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
        here = fleet.classes[place] in fleet.demands[task.name].known
        return DemandSource.MEASURED if here else DemandSource.MEASURED_ELSEWHERE
    return DemandSource.DECLARED if stated is not None and stated.value > 0 else DemandSource.NONE
