"""Percent demands that mean something else on every host: legal, the paper's form, and seldom meant (PAPER-GAPS A20)."""

from collections.abc import Iterator, Sequence

from edgectl.model.assignment import Resource, Uneven
from edgectl.model.task import Quantity, Task, Tasks
from edgectl.scheduler.feasibility import own_robot, rule_against
from edgectl.scheduler.fleet import Fleet

# Capacities further apart than this (greatest over least) are unlike.
UNLIKE = 1.25


def uneven(fleet: Fleet, tasks: Tasks) -> tuple[Uneven, ...]:
    """The percent demands whose meaning differs among the hosts that may run the task: one per entry of the file and resource."""
    entries: dict[str, Task] = {}
    for name in sorted(tasks.tasks):
        task = tasks.tasks[name]
        if task.managed and any(quantity is not None and quantity.relative for quantity in (task.demand.cpu, task.demand.memory)):
            entries.setdefault(task.template, task)
    return tuple(found for task in entries.values() for found in _of(fleet, task))


def _of(fleet: Fleet, task: Task) -> Iterator[Uneven]:
    places = _places(fleet, task)
    for resource, quantity, raw in (
        (Resource.CPU, task.demand.cpu, fleet.raw_cpu),
        (Resource.MEMORY, task.demand.memory, fleet.raw_memory),
    ):
        if quantity is not None and quantity.relative and not (quantity.measured and task.name in fleet.demands):
            yield from _spread(fleet, task, resource, quantity, [(place, raw[place]) for place in places if raw[place] > 0])


def _spread(fleet: Fleet, task: Task, resource: Resource, quantity: Quantity, capacities: Sequence[tuple[int, float]]) -> Iterator[Uneven]:
    if not capacities:
        return
    ordered = sorted(capacities, key=lambda each: (each[1], fleet.order[each[0]]))
    (small, least), (large, most) = ordered[0], ordered[-1]
    if most > UNLIKE * least:
        yield Uneven(
            task=task.template, resource=resource, share=quantity.value, least=quantity.of(least), most=quantity.of(most),
            hosts=(fleet.places[small].name, fleet.places[large].name),
        )  # fmt: skip


def _places(fleet: Fleet, task: Task) -> list[int]:
    """Where the rules of the file let ``task`` run, closed for the moment or not."""
    own = own_robot(fleet, task)
    robots = [own] if own is not None and rule_against(fleet.places[own], task, robot=True) is None else []
    return [edge for edge in range(fleet.edges) if rule_against(fleet.places[edge], task, robot=False) is None] + robots
