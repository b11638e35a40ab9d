"""From samples of a task to its profile (ADR 0025). Pure; the same samples give the same figures."""

from collections.abc import Sequence
from math import ceil

from edgectl.model.manager_state import MeasuredDemand
from edgectl.model.profile import UsagePercentiles, UsageProfile, UsageSample


def build_usage_profile(uses: Sequence[UsageSample], robots: int) -> UsageProfile | None:
    """The figures of a task with ``robots`` links; None without a sample."""
    if not uses:
        return None
    instants = [use.at for use in uses]
    return UsageProfile(
        samples=len(uses),
        span_s=max(instants) - min(instants),
        cpu=_compute_percentiles([use.cores for use in uses]),
        memory=_compute_percentiles([use.memory for use in uses]),
        throughput=_compute_percentiles([_compute_link_rate(use, robots) for use in uses]),
    )


def _compute_link_rate(use: UsageSample, robots: int) -> float:
    """Traffic of one link: spread evenly over those that were used, or over all where the host could not tell."""
    return use.rate / (use.links or max(1, robots))


def _compute_percentiles(values: list[float]) -> UsagePercentiles:
    values.sort()
    return UsagePercentiles(
        p50=compute_percentile(values, 0.50), p95=compute_percentile(values, 0.95), most=values[-1]
    )


def compute_percentile(ordered: Sequence[float], share: float) -> float:
    """Nearest rank: the least of the ``ordered`` values that at least ``share`` (above 0) of them do not exceed."""
    return ordered[max(0, ceil(share * len(ordered) - 1e-9) - 1)]


def measured_demand_from_profile(found: UsageProfile, spec_hash: str = "") -> MeasuredDemand:
    """What counts as the demand: p95. No traffic seen is no figure, for only TCP can be seen."""
    seen = found.throughput.most > 0
    return MeasuredDemand(
        samples=found.samples,
        span_s=found.span_s,
        cpu=found.cpu.p95,
        memory=found.memory.p95,
        throughput=found.throughput.p95 if seen else None,
        spec_hash=spec_hash,
    )
