# SPDX-License-Identifier: Apache-2.0
"""Usage of hosts over a mission, from the counters in the snapshots of its trial (pure, ADR 0132)."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from edgectl.experiments.model.experiment import MissionUsage
from edgectl.model.snapshot import Snapshot, UsageTotals


class _Reading(NamedTuple):
    """Counters of a host at one instant: CPU seconds, bytes (None: not counted), memory in use, and the watts
    that it draws (None: unknown, or shared with other hosts).
    """

    at: float
    cpu_s: float
    network_bytes: float | None
    memory: float
    watts: float | None


# A counter at less than this share of what it was has begun anew.
_ANEW_SHARE = 0.5


class UsageCounters:
    """Counters of the hosts in the snapshots of a trial, without the jumps of reboots and of ended tasks."""

    def __init__(self) -> None:
        self._totals: dict[tuple[str, str], float] = {}
        self._last: dict[tuple[str, str], float] = {}
        self._readings: dict[str, list[_Reading]] = {}

    def record_snapshot(self, snapshot: Snapshot) -> None:
        """Take in the counters of each host that answered with them."""
        for name, sample in snapshot.hosts.items():
            if sample.totals is None or "memory" not in sample.usage:
                continue
            reading = _Reading(
                at=snapshot.taken_at,
                cpu_s=self._count_cpu_s(name, sample.totals),
                network_bytes=self._count(name, "network", sample.totals.network_bytes, known=True),
                memory=sample.usage["memory"].used,
                watts=None if sample.totals.cpu_s is None else sample.device.power_w,
            )
            self._readings.setdefault(name, []).append(reading)

    def compute_usage(self, began: float, ended: float) -> dict[str, MissionUsage]:
        """The usage of each host between two instants, the first of which follows the first snapshot at once.

        A host without at least two snapshots has none.
        """
        return {
            host: _compute_host_usage(readings, began, ended)
            for host, readings in self._readings.items()
            if len(readings) > 1 and ended > began
        }

    def _count_cpu_s(self, host: str, totals: UsageTotals) -> float:
        """CPU seconds so far: of the host, or where it is one of several on a machine of all its tasks."""
        if totals.cpu_s is not None:
            return self._count(host, "cpu", totals.cpu_s, known=True) or 0.0
        first = host not in self._readings
        for instance, seconds in totals.tasks.items():
            self._count(host, f"task/{instance}", seconds, known=first)
        return sum(
            total for (name, key), total in self._totals.items() if name == host and key.startswith("task/")
        )

    def _count(self, host: str, key: str, value: float | None, *, known: bool) -> float | None:
        """What a counter has counted since the first snapshot; one that is far lower than before began anew.

        A little lower is the same: what a supervisor has recorded of an ended task may lack what its
        processes last showed, or a process is read between its end and that of its parent.

        ``known``: it counted before it was first seen, so that its first value is where it starts.
        """
        if value is None:
            return None
        place = host, key
        before = self._last.get(place, value if known else 0.0)
        if _ANEW_SHARE * before < value < before:
            value = before
        self._last[place] = value
        self._totals[place] = self._totals.get(place, 0.0) + (value - before if value >= before else value)
        return self._totals[place]


def _compute_host_usage(readings: Sequence[_Reading], began: float, ended: float) -> MissionUsage:
    return MissionUsage(
        cpu_s=_interpolate_end([(each.at, each.cpu_s) for each in readings], ended),
        network_bytes=None
        if any(each.network_bytes is None for each in readings)
        else _interpolate_end([(each.at, each.network_bytes or 0.0) for each in readings], ended),
        memory=_compute_mean([(each.at, each.memory) for each in readings], began, ended),
        energy=_compute_energy(readings, began, ended),
    )


def _compute_energy(readings: Sequence[_Reading], began: float, ended: float) -> float | None:
    """Joules: the mean draw over the mission by its duration."""
    points = [(each.at, each.watts) for each in readings if each.watts is not None]
    if len(points) < len(readings):
        return None
    return _compute_mean(points, began, ended) * (ended - began)


def _interpolate_end(points: Sequence[tuple[float, float]], ended: float) -> float:
    """The counter at ``ended``, which lies between two readings: up to the next one it rises at the rate that
    the last two show, which were taken after the mission.
    """
    (before, low), (last, high) = points[-2:]
    rate = (high - low) / (last - before) if last > before else 0.0
    after = next(((at, value) for at, value in points if at >= ended), points[-1])
    floor = max((value for at, value in points if at <= ended), default=points[0][1])
    return max(floor, after[1] - rate * (after[0] - ended))


def _compute_mean(readings: Sequence[tuple[float, float]], began: float, ended: float) -> float:
    """The time-weighted mean, linear between the readings of the mission; the nearest one counts before the
    first and after the last of them, since the readings around the mission are of idle hosts.
    """
    inside = [each for each in readings[1:] if each[0] <= ended] or list(readings[1:])
    points = [(began, inside[0][1]), *inside, (max(ended, inside[-1][0]), inside[-1][1])]
    seconds = points[-1][0] - points[0][0]
    if seconds <= 0:
        return inside[0][1]
    return sum(_integrate(points)) / seconds


def _integrate(points: Sequence[tuple[float, float]]) -> Iterator[float]:
    for (start, one), (end, other) in pairwise(points):
        yield (end - start) * (one + other) / 2
