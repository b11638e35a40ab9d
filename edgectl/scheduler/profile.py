"""From samples of a task to its profile (ADR 0025). Pure; the same samples give the same figures."""

from collections.abc import Sequence
from math import ceil

from edgectl.model.memory import MeasuredDemand
from edgectl.model.profile import Profile, Spread, Use


def profile(uses: Sequence[Use], robots: int) -> Profile | None:
    """The figures of a task with ``robots`` links; None without a sample."""
    if not uses:
        return None
    instants = [use.at for use in uses]
    return Profile(
        samples=len(uses),
        span_s=max(instants) - min(instants),
        cpu=_spread([use.cores for use in uses]),
        memory=_spread([use.memory for use in uses]),
        throughput=_spread([_per_link(use, robots) for use in uses]),
    )


def _per_link(use: Use, robots: int) -> float:
    """Traffic of one link: spread evenly over those that were used, or over all where the host could not tell."""
    return use.rate / (use.links or max(1, robots))


def _spread(values: list[float]) -> Spread:
    values.sort()
    return Spread(p50=percentile(values, 0.50), p95=percentile(values, 0.95), most=values[-1])


def percentile(ordered: Sequence[float], share: float) -> float:
    """Nearest rank: the least of the ``ordered`` values that at least ``share`` (above 0) of them do not exceed."""
    return ordered[max(0, ceil(share * len(ordered) - 1e-9) - 1)]


def measured_demand(found: Profile, spec_hash: str = "") -> MeasuredDemand:
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
