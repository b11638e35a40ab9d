"""Snapshots again, from the rows of the history."""

from collections.abc import Iterable
from itertools import groupby
from typing import TypeVar

from edgectl.model.inventory import Inventory
from edgectl.model.point import HostPoint, LinkPoint, TaskPoint
from edgectl.model.snapshot import Cpu, HostSample, HostStatus, LinkSample, MemoryUse, Snapshot, TaskSample

Point = TypeVar("Point", LinkPoint, TaskPoint)


def snapshots_of(
    inventory: Inventory, hosts: Iterable[HostPoint], links: Iterable[LinkPoint], tasks: Iterable[TaskPoint]
) -> tuple[Snapshot, ...]:
    """One snapshot per instant, oldest first; hosts that left the inventory are left out. Rows need not be in order."""
    by_link = _grouped((point.at, point.edge, point) for point in links)
    by_task = _grouped((point.at, point.host, point) for point in tasks)
    ordered = sorted((point for point in hosts if point.host in inventory.hosts), key=lambda point: point.at)
    return tuple(
        Snapshot(
            taken_at=at,
            hosts={
                point.host: _host(inventory, point, by_link.get((at, point.host), []), by_task.get((at, point.host), []))
                for point in points
            },
        )
        for at, points in groupby(ordered, key=lambda point: point.at)
    )


def _grouped(rows: Iterable[tuple[float, str, Point]]) -> dict[tuple[float, str], list[Point]]:
    found: dict[tuple[float, str], list[Point]] = {}
    for at, host, point in rows:
        found.setdefault((at, host), []).append(point)
    return found


def _host(inventory: Inventory, point: HostPoint, links: list[LinkPoint], tasks: list[TaskPoint]) -> HostSample:
    role = inventory.hosts[point.host].role
    if point.status is not HostStatus.OK or not point.cores or not point.total_bytes:
        return HostSample(role=role, status=HostStatus.UNREACHABLE, error="did not answer then")
    return HostSample(
        role=role,
        status=HostStatus.OK,
        cpu=Cpu(cores=point.cores, used_cores=point.used_cores or 0.0),
        memory=MemoryUse(total_bytes=point.total_bytes, used_bytes=point.used_bytes or 0.0),
        links={link.robot: _link(link) for link in links},
        tasks={task.task: _task(task) for task in tasks},
    )


def _link(point: LinkPoint) -> LinkSample:
    return LinkSample(capacity_bytes_per_s=point.capacity_bytes_per_s, used_bytes_per_s=point.used_bytes_per_s, rtt_ms=point.rtt_ms)


def _task(point: TaskPoint) -> TaskSample:
    return TaskSample(
        state=point.state, started_at=point.at - point.age_s, used_cores=point.used_cores, used_bytes=point.used_bytes,
        used_bytes_per_s=point.used_bytes_per_s, instance=point.instance, spec_hash=point.spec_hash,
    )  # fmt: skip
