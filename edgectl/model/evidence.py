"""What comparisons of policies show."""

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
