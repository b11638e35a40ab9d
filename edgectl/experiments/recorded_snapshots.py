# SPDX-License-Identifier: Apache-2.0
"""Snapshots rebuilt from the rows of the history, and their replay."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TypeVar

from edgectl.experiments.model.comparison import ReplayResult
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.replay import replay_snapshots
from edgectl.model.inventory import Inventory
from edgectl.model.point import HostPoint, LinkPoint, TaskPoint
from edgectl.model.snapshot import (
    HostSample,
    HostStatus,
    LinkSample,
    Snapshot,
    TaskSample,
)
from edgectl.usecases.fleet import Fleet

LinkOrTaskPoint = TypeVar("LinkOrTaskPoint", LinkPoint, TaskPoint)


def snapshots_from_points(
    inventory: Inventory, hosts: Iterable[HostPoint], links: Iterable[LinkPoint], tasks: Iterable[TaskPoint]
) -> tuple[Snapshot, ...]:
    """One snapshot per instant, oldest first, without hosts that are no longer in the inventory.

    Rows come in any order.
    """
    by_link = _group_points((point.at, point.edge, point) for point in links)
    by_task = _group_points((point.at, point.host, point) for point in tasks)
    ordered = sorted((point for point in hosts if point.host in inventory.hosts), key=lambda point: point.at)
    return tuple(
        Snapshot(
            taken_at=at,
            hosts={
                point.host: _host_sample_from_point(
                    inventory, point, by_link.get((at, point.host), []), by_task.get((at, point.host), [])
                )
                for point in points
            },
        )
        for at, points in groupby(ordered, key=lambda point: point.at)
    )


def _group_points(
    rows: Iterable[tuple[float, str, LinkOrTaskPoint]],
) -> dict[tuple[float, str], list[LinkOrTaskPoint]]:
    found: dict[tuple[float, str], list[LinkOrTaskPoint]] = {}
    for at, host, point in rows:
        found.setdefault((at, host), []).append(point)
    return found


def _host_sample_from_point(
    inventory: Inventory, point: HostPoint, links: list[LinkPoint], tasks: list[TaskPoint]
) -> HostSample:
    role = inventory.hosts[point.host].role
    found = HostSample(
        role=role,
        status=point.status,
        usage=point.usage,
        links={link.robot: _link_sample_from_point(link) for link in links},
        tasks={task.task: _task_sample_from_point(task) for task in tasks},
    )
    if found.ok and found.measured:
        return found
    return HostSample(role=role, status=HostStatus.UNREACHABLE, error="did not answer")


def _link_sample_from_point(point: LinkPoint) -> LinkSample:
    return LinkSample(
        capacity_bytes_per_s=point.capacity_bytes_per_s,
        used_bytes_per_s=point.used_bytes_per_s,
        rtt_ms=point.rtt_ms,
    )


def _task_sample_from_point(point: TaskPoint) -> TaskSample:
    return TaskSample(
        state=point.state,
        started_at=point.at - point.age_s,
        instance=point.instance,
        spec_hash=point.spec_hash,
        used=point.used,
    )


def replay_schemes(
    fleet: Fleet, snapshots: Sequence[Snapshot], schemes: Sequence[Scheme]
) -> tuple[ReplayResult, ...]:
    """The replay of each scheme over ``snapshots``, which come in any order."""
    ordered = sorted(snapshots, key=lambda snapshot: snapshot.taken_at)
    return tuple(replay_snapshots(fleet.inventory, fleet.tasks, ordered, scheme) for scheme in schemes)


def read_recorded_snapshots(fleet: Fleet, since: float | None = None) -> tuple[Snapshot, ...]:
    """The snapshots in the fleet's history since ``since`` (s since 1970; None: all)."""
    rows = fleet.history.use(
        fleet.state,
        fleet.warn,
        lambda store: (
            store.host_points(since=since),
            store.link_points(since=since),
            store.task_points(since=since),
        ),
    )
    return snapshots_from_points(fleet.inventory, *rows)
