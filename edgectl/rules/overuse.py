# SPDX-License-Identifier: Apache-2.0
"""Running tasks that use more than they declare (ADR 0060)."""

from collections.abc import Iterator

from edgectl.model.assignment import Overuse
from edgectl.model.demand import Quantity
from edgectl.model.inventory import Host, Inventory
from edgectl.model.resource import TASK_RESOURCES, Resource
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample
from edgectl.model.task import Task, Tasks
from edgectl.rules.measured_demand import WARM_UP_S

# Usage is more than declared above this factor, and above what readings vary by: this share of the capacity,
# or the noise of the resource.
OVERUSE_FACTOR, NOISE_SHARE = 1.2, 0.02


def find_overuses(inventory: Inventory, tasks: Tasks, snapshot: Snapshot) -> tuple[Overuse, ...]:
    """The tasks that use more than `OVERUSE_FACTOR` times what they declare. A measured demand declares
    nothing.
    """
    return tuple(
        found
        for name, sample in snapshot.hosts.items()
        if sample.ok and name in inventory.hosts
        for task, run in sample.tasks.items()
        if task in tasks.tasks and _is_typical(tasks.tasks[task], run, snapshot)
        for found in _list_task_overuses(inventory, inventory.hosts[name], sample, tasks.tasks[task], run)
    )


def _is_typical(task: Task, run: TaskSample, snapshot: Snapshot) -> bool:
    return (
        task.managed and run.managed and run.state.alive and snapshot.taken_at - run.started_at >= WARM_UP_S
    )


def _list_task_overuses(
    inventory: Inventory, host: Host, sample: HostSample, task: Task, run: TaskSample
) -> Iterator[Overuse]:
    for resource in TASK_RESOURCES:
        quantity = task.demand[resource.name]
        if quantity is None or quantity.measured:
            continue
        pairs = (
            _list_link_pairs(inventory, host, sample, task, run)
            if resource.per_link
            else _list_host_pairs(host, sample, run, resource)
        )
        above = [
            (used, quantity.of(capacity))
            for used, capacity in pairs
            if _is_above(used, quantity, max(NOISE_SHARE * capacity, resource.noise), capacity)
        ]
        if above:
            used, declared = max(above, key=lambda pair: pair[0] - pair[1])
            yield Overuse(
                task=task.name,
                entry=task.template,
                host=host.name,
                resource=resource,
                used=used,
                declared=declared,
            )


def _is_above(used: float, quantity: Quantity, noise: float, capacity: float) -> bool:
    declared = quantity.of(capacity)
    return used > OVERUSE_FACTOR * declared and used - declared > noise


def _list_host_pairs(
    host: Host, sample: HostSample, run: TaskSample, resource: Resource
) -> list[tuple[float, float]]:
    """Usage and capacity."""
    if resource.name not in sample.usage:
        return []
    stated = host.capacity[resource.name] if host.capacity is not None else 0.0
    return [(run.used[resource.name], stated or sample.usage[resource.name].capacity)]


def _list_link_pairs(
    inventory: Inventory, host: Host, sample: HostSample, task: Task, run: TaskSample
) -> list[tuple[float, float]]:
    """Usage and capacity of each link of the task; evenly spread where the host does not tell."""
    even = run.used["network"] / max(1, len(task.robots))
    return [
        (
            even if run.links is None else run.links.get(robot, 0.0),
            inventory.links.get((host.name, robot), sample.links[robot].nominal_bytes_per_s),
        )
        for robot in task.robots
        if robot in sample.links
    ]
