# SPDX-License-Identifier: Apache-2.0
"""Latency of a task: where its values come from, how they were counted, how a robot hears a task."""

from collections.abc import Iterable, Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.agent.link import sketch
from edgectl.dataclass import dataclass
from edgectl.model.check import CheckLocation
from edgectl.model.encoding import in_document


class StampSource(StrEnum):
    """Where a message says of when its data is."""

    HEADER = "header"


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyRule:
    """Where the latency of a task comes from: the age (ms) of the data that it, or its robot, acts on.

    Either the application metric ``metric`` of the task, or the messages of ``topic``: the time at which they
    arrive minus their ``stamp``, both on the clock of the computer that ``on`` names.
    """

    metric: str = ""
    topic: str = ""
    stamp: StampSource = StampSource.HEADER
    on: CheckLocation = CheckLocation.ROBOT


@dataclass(frozen=True, slots=True, kw_only=True)
class HeardRule:
    """How the robot notices the task: by messages of ``topic``, or a ``command`` there that succeeds.

    A new instance that is not heard within ``within`` seconds leaves the gap of its move unknown.
    """

    topic: str = ""
    command: str = ""
    within: float = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencySample:
    """Latency (ms) of one instance of a task, counted on the host that saw it (ADR 0117).

    ``count``, ``misses`` and ``sum_ms``: of all its values; a miss is a value above ``bound_ms``.
    ``buckets``: those values by the index of their bucket (`edgectl.agent.link.sketch`). ``recent``: those of
    the last ``recent_s`` seconds, from which the percentiles are; they are None without any.
    ``age_s``: time since the last value. ``error``: why nothing is read.
    """

    count: int = 0
    misses: int = 0
    sum_ms: float = 0.0
    bound_ms: float | None = None
    recent_s: float = 0.0
    recent_count: int = 0
    recent_misses: int = 0
    p50_ms: float | None = None
    p95_ms: float | None = None
    p99_ms: float | None = None
    max_ms: float | None = None
    age_s: float | None = None
    buckets: Mapping[str, int] = field(default_factory=dict, metadata=in_document())
    recent: Mapping[str, int] = field(default_factory=dict, metadata=in_document())
    error: str = ""


def merge_latencies(samples: Iterable[LatencySample]) -> LatencySample:
    """One sample of all values of several instances, with percentiles over all of them, not the recent."""
    listed = list(samples)
    buckets = sketch.merge_buckets(
        {int(bucket): count for bucket, count in each.buckets.items()} for each in listed
    )
    return LatencySample(
        count=sum(each.count for each in listed),
        misses=sum(each.misses for each in listed),
        sum_ms=sum(each.sum_ms for each in listed),
        bound_ms=listed[-1].bound_ms if listed else None,
        p50_ms=sketch.find_quantile(buckets, 0.50),
        p95_ms=sketch.find_quantile(buckets, 0.95),
        p99_ms=sketch.find_quantile(buckets, 0.99),
        buckets={str(bucket): buckets[bucket] for bucket in sorted(buckets)},
    )


def list_latency_readings(latency: LatencySample) -> list[tuple[str, float]]:
    """The known figures of a latency, named as those of application metrics are."""
    found = {
        "latency/p50_ms": latency.p50_ms,
        "latency/p95_ms": latency.p95_ms,
        "latency/p99_ms": latency.p99_ms,
        "latency/values": float(latency.count),
        "latency/misses": None if latency.bound_ms is None else float(latency.misses),
    }
    return [(name, value) for name, value in found.items() if value is not None]
