"""Percentiles over known points, worked out by hand."""

from edgectl.model.memory import MeasuredDemand
from edgectl.model.profile import Spread, Use
from edgectl.scheduler.profile import measured_demand, percentile, profile


def uses(*rates: float, links: int = 1) -> list[Use]:
    return [Use(10.0 * at, rate / 100, 1000 + rate, rate, links) for at, rate in enumerate(rates)]


def test_nearest_rank() -> None:
    hundred = [float(n) for n in range(1, 101)]
    assert (percentile(hundred, 0.5), percentile(hundred, 0.95)) == (50.0, 95.0)
    twenty = hundred[:20]
    assert (percentile(twenty, 0.5), percentile(twenty, 0.95)) == (10.0, 19.0)
    assert percentile([7.0], 0.95) == 7.0
    assert percentile([1.0, 2.0, 3.0], 0.95) == 3.0


def test_a_profile_by_hand() -> None:
    found = profile(uses(*range(20, 0, -1)), robots=1)
    assert found is not None
    assert found.cpu == Spread(p50=0.10, p95=0.19, most=0.20)
    assert found.memory == Spread(p50=1010.0, p95=1019.0, most=1020.0)
    assert (found.samples, found.span_s) == (20, 190.0)
    assert measured_demand(found) == MeasuredDemand(samples=20, span_s=190.0, cpu=0.19, memory=1019.0, throughput=19.0)


def test_throughput_is_of_one_link() -> None:
    used = profile(uses(30.0, links=2), robots=3)
    unknown = profile(uses(30.0, links=0), robots=3)
    alone = profile(uses(30.0, links=0), robots=0)
    assert used is not None
    assert unknown is not None
    assert alone is not None
    assert (used.throughput.p95, unknown.throughput.p95, alone.throughput.p95) == (15.0, 10.0, 30.0)


def test_no_sample_is_no_profile_and_no_traffic_is_no_throughput() -> None:
    assert profile([], robots=1) is None
    silent = profile(uses(0.0, 0.0), robots=1)
    assert silent is not None
    assert measured_demand(silent).throughput is None
