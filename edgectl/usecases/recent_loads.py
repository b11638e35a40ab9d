# SPDX-License-Identifier: Apache-2.0
"""Loads of the last minutes, from the history, for runs that keep nothing between two plans (ADR 95)."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from edgectl.dataclass import dataclass
from edgectl.gateway.smoothing import smooth_snapshot
from edgectl.model.event import EventKind
from edgectl.model.point import HostPoint, LinkPoint, TaskPoint
from edgectl.model.resource import NETWORK, RESOURCES, Usage
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample
from edgectl.usecases.fleet import Fleet

if TYPE_CHECKING:
    from edgectl.state.store import Store

# Age (s) of the oldest samples; with the period below nothing would be left of older ones.
WINDOW_S = 600.0
# Nominal time (s) between samples, as of a watch: a run every minute gives its reading a weight of 0.3, one
# every ten minutes 0.97.
PERIOD_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _History:
    """What was recorded, oldest first; ``boots``: the last boot of hosts that have started anew."""

    hosts: tuple[HostPoint, ...]
    links: tuple[LinkPoint, ...]
    tasks: tuple[TaskPoint, ...]
    boots: Mapping[str | None, float]


def smooth_from_history(fleet: Fleet, snapshot: Snapshot, until: float) -> Snapshot:
    """``snapshot`` averaged into the samples that were taken before ``until`` (s since 1970), each by its
    age, with the same function as in a watch.

    What a task cannot go without, such as memory, stays as in ``snapshot`` (ADR 180).
    """
    since = snapshot.taken_at - WINDOW_S

    def read(store: "Store") -> _History:
        events = store.events(since=since)
        return _History(
            hosts=store.host_points(since=since),
            links=store.link_points(since=since),
            tasks=store.task_points(since=since),
            boots={event.host: event.at for event in events if event.kind is EventKind.HOST_REBOOTED},
        )

    known = fleet.history.use(fleet.state, fleet.warn, read)
    smoothed: Snapshot | None = None
    for at in sorted({point.at for point in known.hosts if point.at < until}):
        smoothed = smooth_snapshot(smoothed, _restore_snapshot(fleet, known, snapshot, at), period=PERIOD_S)
    smoothed = smooth_snapshot(smoothed, snapshot, period=PERIOD_S)
    hosts = {name: _restore_urgent(host, snapshot.hosts[name]) for name, host in smoothed.hosts.items()}
    return replace(smoothed, hosts=hosts)


def _restore_urgent(smoothed: HostSample, now: HostSample) -> HostSample:
    """``smoothed`` with the readings of ``now`` of all resources that are not compressible."""
    urgent = [resource.name for resource in RESOURCES if not resource.compressible]
    runs = {
        name: replace(run, used=Usage(run.used, **{each: now.instances[name].used[each] for each in urgent}))
        for name, run in smoothed.instances.items()
    }
    return replace(
        smoothed,
        usage={**smoothed.usage} | {name: now.usage[name] for name in urgent if name in now.usage},
        tasks={name: runs[name] for name in smoothed.tasks},
        standbys={name: runs[name] for name in smoothed.standbys},
    )


def _restore_snapshot(fleet: Fleet, known: _History, now: Snapshot, at: float) -> Snapshot:
    """The loads of ``at``; whatever is not in the history is as ``now``."""
    hosts = {
        point.host: _restore_host(fleet, known, now.hosts[point.host], point)
        for point in known.hosts
        if point.at == at and point.usage and point.host in now.hosts and now.hosts[point.host].ok
        if at >= known.boots.get(point.host, at)
    }
    return replace(now, taken_at=at, hosts=hosts)


def _restore_host(fleet: Fleet, known: _History, now: HostSample, point: HostPoint) -> HostSample:
    links = {
        link.robot: replace(now.links[link.robot], used_bytes_per_s=link.used_bytes_per_s)
        for link in known.links
        if link.at == point.at and link.edge == point.host and link.robot in now.links
    }
    tasks = {
        task.task: _restore_task(fleet, task)
        for task in known.tasks
        if task.at == point.at and task.host == point.host
    }
    return replace(now, usage=point.usage, links=links, tasks=tasks, standbys={}, resident=False)


def _restore_task(fleet: Fleet, point: TaskPoint) -> TaskSample:
    """One task; its traffic is shared out evenly over its robots, as the history has it."""
    task = fleet.tasks.tasks.get(point.task)
    each = point.used[NETWORK.name] / max(1, point.links)
    links = dict.fromkeys(task.robots, each) if task is not None and point.links else None
    return TaskSample(state=point.state, used=point.used, instance=point.instance, links=links)
