"""What comparisons of policies show."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from edgectl.model.policy import Policy


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheme:
    """One way to decide, under a name that tells it from the others."""

    name: str
    policy: Policy


@dataclass(frozen=True, slots=True, kw_only=True)
class Utilisation:
    """Mean and greatest value of one utilisation over hosts (or links) and cycles; shares of the capacity, 0.. (above 1: overload)."""

    mean: float
    peak: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayResult:
    """What one variant would have done over the recorded cycles.

    ``handoffs``: tasks that changed their host. ``unplaced``: tasks without a host, summed over the cycles. ``unsettled``: cycles whose
    plan did not settle. ``assumed``: tasks that it placed and that no record shows running, so that what they demand counts as their use.
    """

    scheme: Scheme
    cycles: int
    handoffs: int
    unplaced: int
    unsettled: int
    assumed: tuple[str, ...] = ()
    cpu: Utilisation
    memory: Utilisation
    network: Utilisation


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """One number over ``count`` runs: mean, standard deviation (n - 1), and half of the 95 % confidence interval of the mean.

    The last two are 0 where ``count`` is 1.
    """

    mean: float
    std: float = 0.0
    half_ci95: float = 0.0
    count: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemeResult:
    """One scheme over all its runs, in the model or on real hosts: a column of the paper's table. None: no run has a value.

    ``figures``: by metric, one for each of ``hosts`` (the edges), or one alone (of the mission; under local execution the mean over the
    robots, and ``hosts`` is empty). Metrics: latency (min), cpu and cpu peak and memory (percent), throughput (MB/s), handoffs (per run);
    of the model rate (frames/s); of real hosts downtime (s, mean of the handoffs) and unplaced (tasks without a host, per run).
    ``metrics``: of the application. ``maps``: SSIM. ``unfinished``: runs that the limit ended. ``unplaced``: summed over all plans.
    """

    scheme: Scheme
    runs: int
    unfinished: int
    unplaced: int
    estimates: Mapping[str, tuple[Estimate | None, ...]]
    hosts: tuple[str, ...] = ()
    metrics: Mapping[str, Estimate | None] = field(default_factory=dict)
    maps: Mapping[str, Estimate | None] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceValues:
    """What stands beside the model's columns. ``word``: where it is from ("published", "measured").

    ``figures``: means by scheme and metric, one for each host of the model's column or one of the whole; None where nothing is known.
    ``notes``: what could not be compared.
    """

    label: str
    means: Mapping[str, Mapping[str, tuple[float | None, ...]]]
    notes: tuple[str, ...] = ()
