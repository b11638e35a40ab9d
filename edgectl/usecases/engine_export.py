# SPDX-License-Identifier: Apache-2.0
"""Tasks at the hosts of a plan, for the files of other engines."""

from dataclasses import replace

from edgectl.export.engine_task import EngineNeed, EngineTask, build_labels
from edgectl.model.assignment import Decision
from edgectl.model.image import ContainerImage
from edgectl.model.inventory import Host
from edgectl.model.plan import Plan
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Task, Tasks
from edgectl.rules.environment import merge_environment
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import make_plan


def plan_for_engine(fleet: Fleet, snapshot: Snapshot | None) -> Plan:
    """The plan of the tasks as if none had an image: which engine a host has is not edgectl's concern here.

    From a fresh probe or from ``snapshot``; it is no part of the history.
    """
    bare = {name: replace(task, image=None) for name, task in fleet.tasks.tasks.items()}
    return make_plan(
        replace(fleet, tasks=replace(fleet.tasks, tasks=bare)),
        fleet.tasks.policy,
        snapshot=snapshot,
        recorded=False,
    )


def list_engine_tasks(fleet: Fleet, plan: Plan, image: str | None) -> list[EngineTask]:
    """The managed tasks to which ``plan`` gives a host, in its order. ``image``: of those without one.

    Raises:
        UsageError: two names of tasks are one in the engine.
    """
    hosts, tasks = fleet.inventory.hosts, fleet.tasks
    placed = {
        step.task: step.decision
        for step in plan.steps
        if step.decision.host in hosts and step.task in tasks.tasks and tasks.tasks[step.task].managed
    }
    labels = build_labels(placed)
    return [
        EngineTask(
            task=tasks.tasks[name],
            host=hosts[decision.host or ""],
            label=labels[name],
            env=merge_environment(tasks.tasks[name], hosts[decision.host or ""], hosts),
            demand=_compute_demand(tasks.tasks[name], hosts[decision.host or ""], decision, plan.snapshot),
            image=_choose_image(tasks.tasks[name], image),
            needs=tuple(
                EngineNeed(label=labels[need.task], host=placed[need.task].host or "", until=need.until)
                for need in tasks.tasks[name].needs
                if need.task in placed
            ),
        )
        for name, decision in placed.items()
    ]


def list_left_out(plan: Plan, tasks: Tasks) -> list[str]:
    """A line for each task that has no host in the plan, or that edgectl does not manage."""
    causes = {
        step.task: "it has no host" if tasks.tasks[step.task].managed else "it is not managed"
        for step in plan.steps
        if step.task in tasks.tasks and (step.decision.host is None or not tasks.tasks[step.task].managed)
    }
    return [f"{name}: left out, {cause}" for name, cause in causes.items()]


def _choose_image(task: Task, given: str | None) -> ContainerImage | None:
    if given is None or (task.image is not None and task.image.name):
        return task.image
    return replace(task.image, name=given) if task.image is not None else ContainerImage(name=given)


def _compute_demand(task: Task, host: Host, decision: Decision, snapshot: Snapshot) -> dict[str, float]:
    """The demand by resource at ``host``: as the plan weighed it, else as it is stated."""
    entry = next((entry for entry in decision.ranking if entry.host == host.name), None)
    weighed = {each.resource.name: each.value for each in entry.demand} if entry is not None else {}
    sample = snapshot.hosts.get(host.name)
    found = {}
    for resource in HOST_RESOURCES:
        quantity, name = task.demand[resource.name], resource.name
        usage = sample.usage.get(name) if sample is not None else None
        declared = host.capacity[name] if host.capacity is not None else 0.0
        capacity = declared or (usage.capacity if usage is not None else 0.0)
        stated = 0.0 if quantity is None else quantity.of(capacity)
        found[name] = weighed.get(name, stated)
    return found
