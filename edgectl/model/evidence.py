"""What comparisons of policies show."""

from collections.abc import Mapping
from dataclasses import dataclass

from edgectl.model.policy import Policy


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One way to decide, under a name that tells it from the others."""

    name: str
    policy: Policy


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """Mean and greatest value of one utilisation over hosts (or links) and cycles; shares of the capacity, 0.. (above 1: overload)."""

    mean: float
    peak: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Replayed:
    """What one variant would have done over the recorded cycles.

    ``handoffs``: tasks that changed their host. ``unplaced``: tasks without a host, summed over the cycles. ``unsettled``: cycles whose
    plan did not settle.
    """

    variant: Variant
    cycles: int
    handoffs: int
    unplaced: int
    unsettled: int
    cpu: Share
    memory: Share
    network: Share


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One number over several runs: mean, standard deviation (n - 1), and half of the 95 % confidence interval of the mean."""

    mean: float
    std: float = 0.0
    half: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """One scheme over all runs. ``figures``: by metric, one per edge, or one alone (of the mission, or the mean over the robots).

    Metrics: latency (min), cpu and cpu peak and memory (percent), throughput (MB/s), rate (frames/s), handoffs (per run).
    ``unfinished``: runs that the limit ended. ``unplaced``: tasks without a host, summed over all plans.
    """

    variant: Variant
    runs: int
    unfinished: int
    unplaced: int
    figures: Mapping[str, tuple[Figure, ...]]
