"""Percent demands that mean something else on every host: legal, the paper's form, and seldom meant (PAPER-GAPS A20)."""

from collections.abc import Iterator, Sequence

from edgectl.model.assignment import DemandSpread, Resource
from edgectl.model.task import Quantity, Task, Tasks
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.feasibility import find_own_robot, find_rule_against

# Capacities further apart than this (greatest over least) are unlike.
MAX_CAPACITY_RATIO = 1.25


def find_demand_spreads(fleet: Capacities, tasks: Tasks) -> tuple[DemandSpread, ...]:
    """The percent demands whose meaning differs among the hosts that may run the task: one per entry of the file and resource."""
    entries: dict[str, Task] = {}
    for name in sorted(tasks.tasks):
        task = tasks.tasks[name]
        if task.managed and any(
            quantity is not None and quantity.relative for quantity in (task.demand.cpu, task.demand.memory)
        ):
            entries.setdefault(task.template, task)
    return tuple(found for task in entries.values() for found in _find_task_spreads(fleet, task))


def _find_task_spreads(fleet: Capacities, task: Task) -> Iterator[DemandSpread]:
    places = _list_allowed_places(fleet, task)
    for resource, quantity, raw in (
        (Resource.CPU, task.demand.cpu, fleet.raw_cpu),
        (Resource.MEMORY, task.demand.memory, fleet.raw_memory),
    ):
        if (
            quantity is not None
            and quantity.relative
            and not (quantity.measured and task.name in fleet.demands)
        ):
            yield from _find_resource_spread(
                fleet, task, resource, quantity, [(place, raw[place]) for place in places if raw[place] > 0]
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
            task=task.template, resource=resource, share=quantity.value, least=quantity.of(least), most=quantity.of(most),
            hosts=(fleet.places[small].name, fleet.places[large].name),
        )  # fmt: skip


def _list_allowed_places(fleet: Capacities, task: Task) -> list[int]:
    """Where the rules of the file let ``task`` run, closed for the moment or not."""
    own = find_own_robot(fleet, task)
    robots = (
        [own] if own is not None and find_rule_against(fleet.places[own], task, robot=True) is None else []
    )
    return [
        edge
        for edge in range(fleet.edges)
        if find_rule_against(fleet.places[edge], task, robot=False) is None
    ] + robots
