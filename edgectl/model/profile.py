"""What a task was measured to use, in figures: of each resource the median, the 95th percentile and the most."""

from dataclasses import dataclass
from typing import NamedTuple

from edgectl.model.task import Task


class UsageSample(NamedTuple):
    """What a task used at one instant (s since 1970), in cores, bytes and bytes/s over ``links`` links (0: not known)."""

    at: float
    cores: float
    memory: float
    rate: float
    links: int


@dataclass(frozen=True, slots=True, kw_only=True)
class UsagePercentiles:
    """Nearest-rank percentiles and the maximum, in cores, bytes or bytes/s."""

    p50: float
    p95: float
    most: float


@dataclass(frozen=True, slots=True, kw_only=True)
class UsageProfile:
    """Of ``samples`` over ``span_s`` seconds. ``throughput`` is of each link; all 0 where no traffic was seen."""

    samples: int
    span_s: float
    cpu: UsagePercentiles
    memory: UsagePercentiles
    throughput: UsagePercentiles


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassProfile:
    """One task on one class of hosts: ``hosts`` are all of that class; ``enough``: there are samples enough to count."""

    task: Task
    kind: str
    hosts: tuple[str, ...]
    profile: UsageProfile
    enough: bool
