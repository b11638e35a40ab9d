"""From samples of a task to its profile (ADR 0025). Pure; the same samples give the same figures."""

from collections.abc import Sequence
from math import ceil

from edgectl.model.memory import MeasuredDemand
from edgectl.model.point import TaskPoint
from edgectl.model.profile import Profile, Spread


def profile(points: Sequence[TaskPoint], robots: int) -> Profile | None:
    """The figures of a task with ``robots`` links; None without a sample."""
    if not points:
        return None
    instants = [point.at for point in points]
    return Profile(
        samples=len(points),
        span_s=max(instants) - min(instants),
        cpu=_spread([point.used_cores for point in points]),
        memory=_spread([point.used_bytes for point in points]),
        throughput=_spread([_per_link(point, robots) for point in points]),
    )


def _per_link(point: TaskPoint, robots: int) -> float:
    """Traffic of one link: spread evenly over those that were used, or over all where the host could not tell."""
    return point.used_bytes_per_s / (point.links or max(1, robots))


def _spread(values: list[float]) -> Spread:
    values.sort()
    return Spread(p50=percentile(values, 0.50), p95=percentile(values, 0.95), most=values[-1])


def percentile(ordered: Sequence[float], share: float) -> float:
    """Nearest rank: the least of the ``ordered`` values that at least ``share`` (above 0) of them do not exceed."""
    return ordered[max(0, ceil(share * len(ordered) - 1e-9) - 1)]


def measured_demand(found: Profile) -> MeasuredDemand:
    """What counts as the demand: p95. No traffic seen is no figure, for only TCP can be seen."""
    seen = found.throughput.most > 0
    return MeasuredDemand(
        samples=found.samples,
        span_s=found.span_s,
        cpu=found.cpu.p95,
        memory=found.memory.p95,
        throughput=found.throughput.p95 if seen else None,
    )
