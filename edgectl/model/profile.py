# SPDX-License-Identifier: Apache-2.0
"""Measured usage of a task: of each resource the median, the 95th percentile and the maximum."""

from collections.abc import Mapping
from typing import NamedTuple

from edgectl.dataclass import dataclass
from edgectl.model.predicted_latency import ServiceTime
from edgectl.model.task import Task


class UsageSample(NamedTuple):
    """Usage of a task at one instant (s since 1970) in the order of RESOURCES, of the network over ``links``
    links (0: not known).
    """

    at: float
    used: tuple[float, ...]
    links: int


@dataclass(frozen=True, slots=True, kw_only=True)
class UsagePercentiles:
    """Nearest-rank percentiles and the maximum, in the unit of the resource."""

    p50: float
    p95: float
    most: float


@dataclass(frozen=True, slots=True, kw_only=True)
class UsageProfile:
    """Figures of ``samples`` over ``span_s`` seconds by resource.

    Of the network, on each link, 0 where no traffic was seen.
    """

    samples: int
    span_s: float
    used: Mapping[str, UsagePercentiles]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassProfile:
    """One task on one class of hosts: ``hosts`` are all of that class.

    ``enough``: there are samples enough to count.
    """

    task: Task
    kind: str
    hosts: tuple[str, ...]
    profile: UsageProfile
    enough: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassService:
    """Service time of one task on one class of hosts, out of ``samples`` at low load."""

    task: Task
    kind: str
    samples: int
    service: ServiceTime
