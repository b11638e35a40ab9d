# SPDX-License-Identifier: Apache-2.0
"""Percentiles over known points, worked out by hand."""

from edgectl.model.manager_state import MeasuredDemand
from edgectl.model.profile import UsagePercentiles, UsageSample
from edgectl.scheduler.profile import build_usage_profile, compute_percentile, measured_demand_from_profile


def usage_samples(*rates: float, links: int = 1) -> list[UsageSample]:
    return [UsageSample(10.0 * at, (rate / 100, 1000 + rate, rate), links) for at, rate in enumerate(rates)]


def test_nearest_rank() -> None:
    hundred = [float(n) for n in range(1, 101)]
    assert (compute_percentile(hundred, 0.5), compute_percentile(hundred, 0.95)) == (50.0, 95.0)
    twenty = hundred[:20]
    assert (compute_percentile(twenty, 0.5), compute_percentile(twenty, 0.95)) == (10.0, 19.0)
    assert compute_percentile([7.0], 0.95) == 7.0
    assert compute_percentile([1.0, 2.0, 3.0], 0.95) == 3.0


def test_a_profile_by_hand() -> None:
    found = build_usage_profile(usage_samples(*range(20, 0, -1)), robots=1)
    assert found is not None
    assert found.used["cpu"] == UsagePercentiles(p50=0.10, p95=0.19, most=0.20)
    assert found.used["memory"] == UsagePercentiles(p50=1010.0, p95=1019.0, most=1020.0)
    assert (found.samples, found.span_s) == (20, 190.0)
    assert measured_demand_from_profile(found) == MeasuredDemand(
        samples=20, span_s=190.0, used={"cpu": 0.19, "memory": 1019.0, "network": 19.0}
    )


def test_throughput_is_of_one_link() -> None:
    used = build_usage_profile(usage_samples(30.0, links=2), robots=3)
    unknown = build_usage_profile(usage_samples(30.0, links=0), robots=3)
    alone = build_usage_profile(usage_samples(30.0, links=0), robots=0)
    assert used is not None
    assert unknown is not None
    assert alone is not None
    assert [each.used["network"].p95 for each in (used, unknown, alone)] == [15.0, 10.0, 30.0]


def test_no_sample_is_no_profile_and_no_traffic_is_no_throughput() -> None:
    assert build_usage_profile([], robots=1) is None
    silent = build_usage_profile(usage_samples(0.0, 0.0), robots=1)
    assert silent is not None
    assert "network" not in measured_demand_from_profile(silent).used
