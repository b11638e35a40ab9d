"""Smoothing of the snapshots of a watch: an exponentially weighted mean over time. Pure.

The load of everything unmanaged and the usage of each task are smoothed separately. So a task that starts,
stops or moves changes the load of its host at once and whole, and only the noise around it is spread over
time.
"""

import dataclasses
from collections.abc import Mapping

from edgectl.model.snapshot import CpuUsage, HostSample, LinkSample, MemoryUsage, Snapshot, TaskSample

# Weight of a new sample that comes one period after the one before (as of the profilers in the paper).
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
    tasks = {name: _smooth_task(before.tasks.get(name), task, weight) for name, task in now.tasks.items()}
    was, ours, averaged = _select_alive(before.tasks), _select_alive(now.tasks), _select_alive(tasks)
    cpu, memory = now.cpu, now.memory
    if before.cpu is not None and cpu is not None:
        others = _compute_mean(
            before.cpu.used_cores - _sum_cores(was), cpu.used_cores - _sum_cores(ours), weight
        )
        cpu = CpuUsage(cores=cpu.cores, used_cores=max(0.0, others + _sum_cores(averaged)))
    if before.memory is not None and memory is not None:
        rest = _compute_mean(
            before.memory.used_bytes - _sum_bytes(was), memory.used_bytes - _sum_bytes(ours), weight
        )
        memory = MemoryUsage(total_bytes=memory.total_bytes, used_bytes=max(0.0, rest + _sum_bytes(averaged)))
    links = {
        robot: _smooth_link(robot, before.links[robot], link, (was, ours, averaged), weight)
        if robot in before.links
        else link
        for robot, link in now.links.items()
    }
    return dataclasses.replace(now, cpu=cpu, memory=memory, links=links, tasks=tasks)


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
        used_cores=_compute_mean(before.used_cores, now.used_cores, weight),
        used_bytes=_compute_mean(before.used_bytes, now.used_bytes, weight),
        used_bytes_per_s=_compute_mean(before.used_bytes_per_s, now.used_bytes_per_s, weight),
        links=links or now.links,
    )


def _smooth_link(
    robot: str,
    before: LinkSample,
    now: LinkSample,
    tasks: tuple[list[TaskSample], list[TaskSample], list[TaskSample]],
    weight: float,
) -> LinkSample:
    was, ours, averaged = (sum((task.links or {}).get(robot, 0.0) for task in each) for each in tasks)
    others = _compute_mean(before.used_bytes_per_s - was, now.used_bytes_per_s - ours, weight)
    return dataclasses.replace(now, used_bytes_per_s=max(0.0, others + averaged))


def _select_alive(tasks: Mapping[str, TaskSample]) -> list[TaskSample]:
    return [task for task in tasks.values() if task.state.alive]


def _sum_cores(tasks: list[TaskSample]) -> float:
    return sum(task.used_cores for task in tasks)


def _sum_bytes(tasks: list[TaskSample]) -> float:
    return sum(task.used_bytes for task in tasks)


def _compute_mean(before: float, now: float, weight: float) -> float:
    return before + weight * (now - before)
