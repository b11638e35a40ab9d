"""rho, the demand of a task on the host that is looked at (ADR 0025): declared, or measured on that class of hosts."""

from dataclasses import replace

from edgectl.model.assignment import DemandSource, Resource, Rho
from edgectl.model.demand import elsewhere, enough, host_class, of_today, resolved
from edgectl.model.memory import MeasuredDemand, Memory
from edgectl.model.task import ZERO, Demand, Quantity, Task, Tasks
from edgectl.scheduler.fleet import Fleet

# In place of a class without enough history.
OTHER = ""


def with_history(fleet: Fleet, tasks: Tasks, memory: Memory) -> Fleet:
    """The fleet with the demands that ``memory`` has measured; nothing is done where there are none."""
    if not memory.measured:
        return fleet
    known: dict[str, dict[str, MeasuredDemand]] = {}
    history = {key: found for key, found in memory.measured.items() if key[0] in tasks.tasks and of_today(tasks.tasks[key[0]], found)}
    for (task, kind), found in history.items():
        if enough(found):
            known.setdefault(task, {})[kind] = found
    demands = {task: _by_class(tasks.tasks[task].demand, found) for task, found in known.items()}
    classes = tuple(
        host_class(host, cores, total) if cores > 0 and total > 0 else OTHER
        for host, cores, total in zip(fleet.places, fleet.raw_cpu, fleet.raw_memory, strict=True)
    )
    return replace(fleet, classes=classes, demands=demands, history=history)


def _by_class(stated: Demand, known: dict[str, MeasuredDemand]) -> dict[str, Demand]:
    return {kind: resolved(stated, found) for kind, found in known.items()} | {OTHER: elsewhere(stated, known.values())}


def demand_at(fleet: Fleet, task: Task, place: int) -> Demand:
    """What ``task`` demands at ``place``."""
    own = fleet.demands.get(task.name)
    if own is None:
        return task.demand
    return own.get(fleet.classes[place]) or own[OTHER]


def demands_at(fleet: Fleet, task: Task, place: int) -> tuple[Rho, ...]:
    """The demands of ``task`` at ``place`` in absolute numbers, and where they come from."""
    wanted = demand_at(fleet, task, place)
    links = (fleet.links[robot][place] for robot in task.robots if robot in fleet.links) if place < fleet.edges else ()
    capacity = max((link for link in links if link is not None), default=None)
    found = [
        _rho(fleet, task, place, Resource.CPU, (task.demand.cpu, wanted.cpu), fleet.raw_cpu[place]),
        _rho(fleet, task, place, Resource.MEMORY, (task.demand.memory, wanted.memory), fleet.raw_memory[place]),
    ]
    if capacity is not None:
        found.append(_rho(fleet, task, place, Resource.NETWORK, (task.demand.throughput, wanted.throughput), capacity))
    return tuple(found)


def _rho(
    fleet: Fleet, task: Task, place: int, resource: Resource, quantities: tuple[Quantity | None, Quantity | None], capacity: float
) -> Rho:
    """``quantities``: as stated, and as it counts at ``place``."""
    stated, wanted = quantities
    value = (wanted or ZERO).of(capacity)
    if stated is not None and not stated.measured:
        return Rho(resource=resource, value=value, source=DemandSource.DECLARED)
    history = fleet.history.get((task.name, fleet.classes[place])) if fleet.classes else None
    return Rho(
        resource=resource, value=value, source=_source(fleet, task, place, stated, wanted), samples=history.samples if history else 0
    )


def _source(fleet: Fleet, task: Task, place: int, stated: Quantity | None, wanted: Quantity | None) -> DemandSource:
    if wanted is not stated and wanted is not None:
        here = fleet.classes[place] in fleet.demands[task.name]
        return DemandSource.MEASURED if here else DemandSource.MEASURED_ELSEWHERE
    return DemandSource.DECLARED if stated is not None and stated.value > 0 else DemandSource.NONE
