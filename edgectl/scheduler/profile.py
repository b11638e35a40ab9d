# SPDX-License-Identifier: Apache-2.0
"""Usage profile of a task from its samples (ADR 0025). Pure; the same samples give the same figures."""

from collections.abc import Sequence
from math import ceil

from edgectl.model.manager_state import MeasuredDemand
from edgectl.model.profile import UsagePercentiles, UsageProfile, UsageSample
from edgectl.model.resource import TASK_RESOURCES


def build_usage_profile(uses: Sequence[UsageSample], robots: int) -> UsageProfile | None:
    """The figures of a task with ``robots`` links; None without a sample."""
    if not uses:
        return None
    instants = [use.at for use in uses]
    return UsageProfile(
        samples=len(uses),
        span_s=max(instants) - min(instants),
        used={
            resource.name: _compute_percentiles(
                [use.used[column] / (_count_links(use, robots) if resource.per_link else 1) for use in uses]
            )
            for column, resource in enumerate(TASK_RESOURCES)
        },
    )


def _count_links(use: UsageSample, robots: int) -> int:
    """The links over which traffic is spread evenly: those that were used, or all where the host could not
    tell.
    """
    return use.links or max(1, robots)


def _compute_percentiles(values: list[float]) -> UsagePercentiles:
    values.sort()
    return UsagePercentiles(
        p50=compute_percentile(values, 0.50), p95=compute_percentile(values, 0.95), most=values[-1]
    )


def compute_percentile(ordered: Sequence[float], share: float) -> float:
    """Nearest rank: the least of the ``ordered`` values that at least ``share`` (above 0) of them do not
    exceed.
    """
    return ordered[max(0, ceil(share * len(ordered) - 1e-9) - 1)]


def measured_demand_from_profile(found: UsageProfile, spec_hash: str = "") -> MeasuredDemand:
    """The demand that counts: p95. No traffic seen is no figure, for only TCP can be seen."""
    return MeasuredDemand(
        samples=found.samples,
        span_s=found.span_s,
        used={
            resource.name: found.used[resource.name].p95
            for resource in TASK_RESOURCES
            if not resource.per_link or found.used[resource.name].most > 0
        },
        spec_hash=spec_hash,
    )
