# SPDX-License-Identifier: Apache-2.0
"""The model of latency: its closed forms at known points, and against simulated jobs on shared cores."""

from itertools import pairwise
from math import exp, inf, log
from random import Random

import pytest

from edgectl.model.predicted_latency import PredictedLatency, ServiceTime
from edgectl.rules.latency import HostLoad, LinkLoad, estimate_latency
from edgectl.rules.waiting import (
    MAX_LOAD,
    compute_busy_probability,
    compute_waiting,
    compute_waiting_quantile,
)

STEADY = ServiceTime(p50=0.030, p95=0.030)


def estimate(
    cores: float, load: float, link: LinkLoad | None = None, size: float = 0.0, service: ServiceTime = STEADY
) -> PredictedLatency:
    return estimate_latency(service, HostLoad(cores, cores * load), link, size)


@pytest.mark.parametrize(
    ("cores", "load", "busy"),
    [(1, 0.3, 0.3), (1, 0.9, 0.9), (2, 0.5, 1 / 3), (3, 2 / 3, 4 / 9), (4, 0.75, 0.5094339622641509)],
)
def test_erlang_c_has_its_tabled_values(cores: int, load: float, busy: float) -> None:
    assert compute_busy_probability(cores, load) == pytest.approx(busy)


@pytest.mark.parametrize("load", [0.1, 0.5, 0.9])
def test_one_core_is_m_m_1_with_processor_sharing(load: float) -> None:
    """Mean x / (1 - rho); variance of Yashkov; nobody else comes: (1 - rho) exp(-lambda x)."""
    found = compute_waiting(0.030, 0.010, 1, load)
    assert found.mean + 0.030 == pytest.approx(0.030 / (1.0 - load))
    idle, rate = 1.0 - load, 1.0 / 0.010
    expected = 2 * load * 0.030 / (rate * idle**3) - 2 * load / (rate**2 * idle**4) * (
        1.0 - exp(-rate * idle * 0.030)
    )
    assert found.variance == pytest.approx(expected)
    assert found.none == pytest.approx(idle * exp(-load * rate * 0.030))


def test_a_very_short_job_sees_the_others_as_they_stand() -> None:
    """Its time is x (1 + N) with N geometric: variance x^2 rho / (1 - rho)^2."""
    near = compute_waiting(1e-7, 0.010, 1, 0.5)
    assert near.variance == pytest.approx(1e-14 * 0.5 / 0.25, rel=1e-3)
    assert compute_waiting(2e-6, 0.010, 1, 0.5).variance == pytest.approx(4e-12 * 2.0, rel=1e-3)


def test_a_very_long_job_gets_its_share() -> None:
    found = compute_waiting(100.0, 0.010, 1, 0.5)
    assert found.mean == pytest.approx(100.0)
    assert found.variance**0.5 / found.mean < 0.03


@pytest.mark.parametrize(("cores", "load"), [(1, 0.3), (1, 0.6), (1, 0.8), (2, 0.6), (4, 0.8)])
def test_the_percentiles_are_those_of_simulated_jobs(cores: int, load: float) -> None:
    """The bars of the model where its assumptions hold: 6 % at p50, 12 % at p99, nine of ten in the interval."""
    times = simulate_jobs(cores, load, 0.030, 6000)
    found = estimate(cores, load)
    p50, p95, p99 = (1000.0 * times[int(share * len(times))] for share in (0.50, 0.95, 0.99))
    assert found.p50_ms == pytest.approx(p50, rel=0.06)
    assert found.p95_ms == pytest.approx(p95, rel=0.10)
    assert found.p99_ms == pytest.approx(p99, rel=0.12)
    inside = sum(found.low_ms <= 1000.0 * each <= found.high_ms for each in times)
    assert inside / len(times) >= 0.90


def simulate_jobs(cores: int, load: float, work: float, count: int) -> list[float]:
    """The sorted times of ``count`` jobs of ``work`` s, one at a time, among others of the same mean length."""
    random, found = Random(7), list[float]()
    rate, now, started = load * cores / work, 0.0, -1.0
    others: list[float] = []
    own, comes, starts = inf, random.expovariate(rate), 8 * work
    while len(found) < count:
        here = len(others) + (own < inf)
        speed = min(1.0, cores / here) if here else 0.0
        ends = now + min([own, *others]) / speed if here else inf
        step = min(ends, comes, starts)
        others = [left - (step - now) * speed for left in others]
        own -= (step - now) * speed
        now = step
        if step == ends:
            if own <= min(others, default=inf):
                found.append(now - started)
                own, starts = inf, now + random.expovariate(1.0 / (8 * work))
            else:
                others.remove(min(others))
        elif step == comes:
            others.append(random.expovariate(1.0 / work))
            comes = now + random.expovariate(rate)
        else:
            own, started, starts = work, now, inf
    return sorted(found)


def test_an_idle_host_takes_the_service_time_and_its_spread() -> None:
    found = estimate(4, 0.0, service=ServiceTime(p50=0.030, p95=0.036))
    assert [found.p50_ms, found.p95_ms, found.waiting_ms] == pytest.approx([30.0, 36.0, 0.0])
    assert found.low_ms == pytest.approx(0.9 * 25.0)
    assert found.high_ms == pytest.approx(1.1 * 36.0)


def test_a_longer_job_waits_longer() -> None:
    """Its length and its slowdown are factors: 50 % at p95, and of the others' work the same share of both."""
    steady, uneven = (estimate(1, 0.5, service=ServiceTime(p50=0.030, p95=p95)) for p95 in (0.030, 0.045))
    slower = steady.p95_ms / 30.0
    assert uneven.p50_ms == pytest.approx(steady.p50_ms)
    assert uneven.p95_ms == pytest.approx(30.0 * exp((log(slower) ** 2 + log(1.5) ** 2) ** 0.5))
    assert steady.p95_ms < uneven.p95_ms < 1.5 * steady.p95_ms


def test_the_parts_of_the_way_add_up() -> None:
    """200 kB at 16.67 of 25 MB/s: 12 ms; and the round trip."""
    link = LinkLoad(25e6, 25e6 / 3, 0.004)
    found = estimate(4, 0.0, link, 200e3)
    assert found.transfer_ms == pytest.approx(12.0)
    assert found.rtt_ms == 4.0
    assert found.p50_ms == found.p99_ms == pytest.approx(46.0)
    assert estimate(4, 0.0, None, 200e3).p50_ms == pytest.approx(30.0), "on the robot itself nothing is sent"
    assert estimate(4, 0.0, LinkLoad(inf, 0.0, 0.0), 200e3).transfer_ms == 0.0


def test_more_load_is_never_faster_and_nothing_is_infinite() -> None:
    loads = [0.0, 0.2, 0.5, 0.8, 0.95, MAX_LOAD, 1.5]
    for cores in (0.5, 1.0, 4.0):
        found = [estimate(cores, load, LinkLoad(1e6, load * 1e6, 0.0), 1e4) for load in loads]
        for less, more in pairwise(found):
            assert less.p50_ms <= more.p50_ms
            assert less.p95_ms <= more.p95_ms
            assert less.p99_ms <= more.p99_ms
        assert all(0 < each.low_ms <= each.p50_ms <= each.p95_ms <= each.p99_ms < inf for each in found)
        assert found[-1].host_load == 1.5, "said as it is"


def test_a_part_of_a_core_is_a_slow_core() -> None:
    assert estimate(0.5, 0.0).p50_ms == pytest.approx(60.0)


@pytest.mark.parametrize("load", [0.3, 0.6])
def test_few_others_meet_less_often(load: float) -> None:
    """One other task: it is busy a share rho of the time, and a job waits for no more than one of its jobs."""
    alone = compute_waiting(0.030, 0.030, 1, load, 1)
    assert alone.mean == pytest.approx(0.030 * load)
    found = estimate_latency(STEADY, HostLoad(1.0, load, 1), None, 0.0)
    assert found.p99_ms == pytest.approx(60.0), "both take turns"
    means = [compute_waiting(0.030, 0.030, 1, load, count).mean for count in (1, 2, 8, 1e9)]
    assert means == sorted(means)
    assert means[-1] == pytest.approx(0.030 * load / (1 - load))


def test_others_that_are_fewer_than_the_cores_are_not_felt() -> None:
    assert estimate_latency(STEADY, HostLoad(4.0, 2.4, 3), None, 0.0).p99_ms == pytest.approx(30.0)


def test_quantiles_of_waiting_begin_at_nothing() -> None:
    waiting = compute_waiting(0.030, 0.030, 4, 0.3)
    assert waiting.none > 0.8
    assert compute_waiting_quantile(waiting, 0.5) == 0.0
    assert 0.0 < compute_waiting_quantile(waiting, 0.99) < 0.05
