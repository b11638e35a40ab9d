# SPDX-License-Identifier: Apache-2.0
"""Builders with defaults, so that a test shows only its relevant values. Quantities: cores, bytes, bytes/s."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from edgectl.model.check import Check, CheckLocation
from edgectl.model.demand import Demand, Quantity
from edgectl.model.inventory import Host, Inventory, Limits, Role
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.snapshot import (
    HostSample,
    HostStatus,
    LinkSample,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.model.standby import Activation, StandbyRule
from edgectl.model.task import HostRules, Need, NeedCondition, Task, Tasks
from edgectl.names import natural_key

# The task file of every task.
TASK_FILE = "tasks.yaml"
NOW = 1_763_690_000.0
GI = float(2**30)


def an_edge(
    name: str = "edge1", *, cpu_limit: float = 1.0, memory_limit: float = 1.0, **fields: object
) -> Host:
    """An edge of the inventory."""
    host = Host(
        name=name, role=Role.EDGE, host=f"{name}.lab", limits=Limits(cpu=cpu_limit, memory=memory_limit)
    )
    return replace(host, **fields)  # type: ignore[arg-type]


def a_robot(name: str = "robot1", **fields: object) -> Host:
    """A robot of the inventory."""
    return replace(Host(name=name, role=Role.ROBOT, host=f"{name}.lab"), **fields)  # type: ignore[arg-type]


def an_inventory(
    *hosts: Host, links: Mapping[tuple[str, str], float] | None = None, probe_links: bool = True
) -> Inventory:
    """The fleet, in natural order of names."""
    ordered = sorted(hosts, key=lambda host: natural_key(host.name))
    return Inventory(
        hosts={host.name: host for host in ordered},
        links=links or {},
        digest="inventory-digest",
        is_fleet_named=True,
        probe_links=probe_links,
    )


def a_quantity(value: float | str | Quantity | None) -> Quantity | None:
    """``0.5`` is absolute, ``"35%"`` a share."""
    if isinstance(value, Quantity):
        return value
    if isinstance(value, str):
        return Quantity(value=float(value.removesuffix("%")) / 100.0, relative=True)
    return None if value is None else Quantity(value=value)


def a_task(
    name: str = "slam",
    *,
    cpu: float | str | Quantity | None = 0.0,
    memory: float | str | Quantity | None = 0.0,
    throughput: float | str | Quantity | None = 0.0,
    robots: Iterable[str] = (),
    needs: Iterable[str | Need] = (),
    only: Iterable[str] = (),
    never: Iterable[str] = (),
    labels: Mapping[str, str] | None = None,
    pin: str | None = None,
    **fields: object,
) -> Task:
    """A task; ``needs`` are names or Needs."""
    task = Task(
        name=name,
        template=name,
        command=f"run {name}",
        spec_hash=f"hash-{name}",
        file=TASK_FILE,
        demand=Demand(cpu=a_quantity(cpu), memory=a_quantity(memory), network=a_quantity(throughput)),
        robots=tuple(robots),
        needs=tuple(
            need if isinstance(need, Need) else Need(task=need, until=NeedCondition.READY) for need in needs
        ),
        hosts=HostRules(only=tuple(only), never=tuple(never), labels=labels or {}, pin=pin),
    )
    return replace(task, **fields)  # type: ignore[arg-type]


def a_standby_rule(
    *,
    hosts: int = 1,
    cpu: float | str | None = None,
    memory: float | str | None = None,
    **activation: Any,
) -> StandbyRule:
    """A pair of commands, and what a copy needs while it is inactive."""
    return StandbyRule(
        activation=Activation(
            activate=Check(command="wake", on=CheckLocation.HOST),
            deactivate=Check(command="sleep", on=CheckLocation.HOST),
            **activation,
        ),
        hosts=hosts,
        demand=Demand(cpu=a_quantity(cpu), memory=a_quantity(memory)),
    )


def some_tasks(*tasks: Task, policy: Policy | None = None) -> Tasks:
    """A task file after expansion."""
    ordered = sorted(tasks, key=lambda task: natural_key(task.name))
    return Tasks(
        tasks={task.name: task for task in ordered},
        policy=policy or Policy(),
        digest="tasks-digest",
        files=frozenset({TASK_FILE}),
    )


def a_link(capacity: float = 10e6, used: float = 0.0) -> LinkSample:
    """One edge-robot link, 10 MB/s and idle."""
    return LinkSample(capacity_bytes_per_s=capacity, used_bytes_per_s=used)


def a_run(state: TaskState = TaskState.READY, **fields: Any) -> TaskSample:
    """A task found on a host: ready, old enough to be moved, with the present specification where the test
    gives it.
    """
    return replace(
        TaskSample(state=state, pid=4242, started_at=NOW - 3600.0, instance="instance-1", file=TASK_FILE),
        **fields,
    )


def a_sample(
    *,
    cores: float = 4.0,
    used: float = 0.0,
    memory: float = 4 * GI,
    used_memory: float = 0.0,
    links: Mapping[str, LinkSample] | None = None,
    tasks: Mapping[str, TaskSample] | None = None,
    standbys: Mapping[str, TaskSample] | None = None,
    role: Role = Role.EDGE,
    age: float = 0.0,
) -> HostSample:
    """A host that answered: 4 cores, 4 GiB, idle."""
    return HostSample(
        role=role,
        status=HostStatus.OK,
        sample_age_s=age,
        usage={
            "cpu": ResourceUsage(capacity=cores, used=used),
            "memory": ResourceUsage(capacity=memory, used=used_memory),
        },
        links=links or {},
        tasks=tasks or {},
        standbys=standbys or {},
    )


def silent(role: Role = Role.EDGE) -> HostSample:
    """A host that did not answer."""
    return HostSample(
        role=role, status=HostStatus.UNREACHABLE, error="connection refused", error_kind="connect"
    )


def a_snapshot(
    found: Mapping[str, HostSample] | None = None,
    /,
    *,
    taken_at: float = NOW,
    memory: ManagerState | None = None,
    **hosts: HostSample,
) -> Snapshot:
    """The fleet at one instant, hosts by name: ``a_snapshot(edge1=a_sample(used=1.0))``."""
    return Snapshot(taken_at=taken_at, hosts={**(found or {}), **hosts}, manager=memory)
