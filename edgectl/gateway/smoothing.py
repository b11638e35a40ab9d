# SPDX-License-Identifier: Apache-2.0
"""Smoothing of the snapshots of a watch: an exponentially weighted mean over time. Pure.

The load of everything unmanaged and the usage of each task are smoothed separately. So a task that starts,
stops or moves changes the load of its host at once and whole, and only the noise around it is spread over
time.
"""

import dataclasses
from collections.abc import Mapping

from edgectl.dataclass import replace_fields
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, LinkSample, ResourceUsage, Snapshot, TaskSample

# Weight of a new sample that comes one period after the one before (the paper's profilers).
ALPHA = 0.3


def smooth_snapshot(
    before: Snapshot | None, now: Snapshot, *, period: float, alpha: float = ALPHA
) -> Snapshot:
    """``now`` with its loads averaged into ``before``, the smoothed snapshot of the cycle before.

    ``period`` (s): the nominal time between samples; a later sample weighs more,
    ``1 - (1 - alpha) ** (elapsed / period)``. Not averaged: a host that was unreachable, is new, was rebooted
    or smooths by its own profiler; and a task that was restarted.
    """
    if before is None:
        return now
    elapsed = now.taken_at - before.taken_at
    weight = 1.0 - (1.0 - alpha) ** (elapsed / period if elapsed > 0 else 1.0)
    return dataclasses.replace(
        now,
        hosts={name: _smooth_host(before.hosts.get(name), host, weight) for name, host in now.hosts.items()},
    )


def _smooth_host(before: HostSample | None, now: HostSample, weight: float) -> HostSample:
    if before is None or not _is_continuation(before, now):
        return now
    found = before.instances
    runs = {name: _smooth_task(found.get(name), task, weight) for name, task in now.instances.items()}
    was, ours, averaged = _select_alive(found), _select_alive(now.instances), _select_alive(runs)
    usage = {
        name: _smooth_usage(name, before.usage[name], found, (was, ours, averaged), weight)
        if name in before.usage
        else found
        for name, found in now.usage.items()
    }
    return replace_fields(
        now,
        usage=usage,
        links=_smooth_links(before.links, now.links, (was, ours, averaged), weight),
        tasks={name: runs[name] for name in now.tasks},
        standbys={name: runs[name] for name in now.standbys},
    )


def _is_continuation(before: HostSample, now: HostSample) -> bool:
    """Whether both samples are of one boot of the host, and its readings are not smoothed already."""
    return before.ok and now.ok and not now.resident and before.device.boot_id == now.device.boot_id


def _smooth_task(before: TaskSample | None, now: TaskSample, weight: float) -> TaskSample:
    if before is None or before.instance != now.instance or not (before.state.alive and now.state.alive):
        return now
    known = before.links or {}
    links = {
        robot: _compute_mean(known.get(robot, rate), rate, weight)
        for robot, rate in (now.links or {}).items()
    }
    return dataclasses.replace(
        now,
        used=Usage(
            {name: _compute_mean(before.used[name], amount, weight) for name, amount in now.used.items()}
        ),
        links=links or now.links,
    )


def _smooth_usage(
    name: str,
    before: ResourceUsage,
    now: ResourceUsage,
    tasks: tuple[list[TaskSample], list[TaskSample], list[TaskSample]],
    weight: float,
) -> ResourceUsage:
    was, ours, averaged = (sum([task.used[name] for task in each]) if each else 0.0 for each in tasks)
    others = _compute_mean(before.used - was, now.used - ours, weight)
    return ResourceUsage(capacity=now.capacity, used=max(0.0, others + averaged))


def _smooth_links(
    before: Mapping[str, LinkSample],
    now: Mapping[str, LinkSample],
    tasks: tuple[list[TaskSample], list[TaskSample], list[TaskSample]],
    weight: float,
) -> Mapping[str, LinkSample]:
    if not any(tasks) and before == now:
        # The mean of equal values; most links of a large fleet are idle.
        return now
    return {
        robot: _smooth_link(robot, before[robot], link, tasks, weight) if robot in before else link
        for robot, link in now.items()
    }


def _smooth_link(
    robot: str,
    before: LinkSample,
    now: LinkSample,
    tasks: tuple[list[TaskSample], list[TaskSample], list[TaskSample]],
    weight: float,
) -> LinkSample:
    was, ours, averaged = (_sum_links(robot, each) if each else 0.0 for each in tasks)
    others = _compute_mean(before.used_bytes_per_s - was, now.used_bytes_per_s - ours, weight)
    used = max(0.0, others + averaged)
    return now if used == now.used_bytes_per_s else dataclasses.replace(now, used_bytes_per_s=used)


def _sum_links(robot: str, tasks: list[TaskSample]) -> float:
    return sum((task.links or {}).get(robot, 0.0) for task in tasks)


def _select_alive(tasks: Mapping[str, TaskSample]) -> list[TaskSample]:
    return [task for task in tasks.values() if task.state.alive]


def _compute_mean(before: float, now: float, weight: float) -> float:
    return before + weight * (now - before)
