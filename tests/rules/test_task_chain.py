# SPDX-License-Identifier: Apache-2.0
"""The chain of a few tasks beside a job: closed forms at its ends, and simulated tasks in between."""

from itertools import pairwise
from math import exp, inf
from random import Random

import pytest

from edgectl.model.predicted_latency import ServiceTime
from edgectl.rules.latency import HostLoad, estimate_latency
from edgectl.rules.task_chain import build_chain, compute_chain_waiting
from edgectl.rules.waiting import CHAIN_CORES, CHAIN_TASKS, compute_waiting


@pytest.mark.parametrize("load", [0.1, 0.4, 0.8])
def test_one_other_task_is_on_or_off(load: float) -> None:
    """It begins at rho and ends at 1 - rho: a telegraph signal, whose time spent on has a known variance."""
    found = compute_chain_waiting(1, 1, load, 2.0)
    assert found.mean == pytest.approx(2.0 * load)
    assert found.variance == pytest.approx(2.0 * load * (1.0 - load) * (2.0 - 1.0 + exp(-2.0)), rel=1e-3)
    assert found.none == pytest.approx((1.0 - load) * exp(-2.0 * load), rel=1e-3)


@pytest.mark.parametrize("load", [0.2, 0.5, 0.7])
def test_very_many_tasks_are_m_m_1(load: float) -> None:
    many, chain = compute_waiting(1.0, 1.0, 1, load), compute_chain_waiting(300, 1, load, 1.0)
    assert chain.mean == pytest.approx(many.mean, rel=0.03)
    assert chain.variance == pytest.approx(many.variance, rel=0.12)
    assert chain.none == pytest.approx(many.none, rel=0.03)


@pytest.mark.parametrize(("others", "cores"), [(1, 1), (4, 1), (4, 4), (9, 2)])
def test_the_cores_do_the_work_that_comes(others: int, cores: int) -> None:
    chain = build_chain(others, cores, 0.6)
    assert sum(chain.presence) == pytest.approx(1.0)
    busy = sum(share * min(count, cores) for count, share in enumerate(chain.presence))
    assert busy == pytest.approx(0.6 * cores)
    assert [delay > 0.0 for delay in chain.delays] == [count >= cores for count in range(others + 1)]


@pytest.mark.parametrize("cores", [1, 2, CHAIN_CORES, CHAIN_CORES + 4])
def test_more_tasks_wait_longer_up_to_very_many(cores: int) -> None:
    """Also where a chain is no longer solved for all of them."""
    counts = [cores, cores + 1, cores + 5, cores + CHAIN_TASKS, cores + CHAIN_TASKS + 1, 50, 10_000, inf]
    found = [compute_waiting(1.0, 1.0, cores, 0.7, count) for count in counts]
    for less, more in pairwise(found):
        assert 0.0 < less.mean < more.mean
        assert 0.0 < less.variance < more.variance
        # On one core nobody waits for whom the core is idle, and stays so: the same for any number.
        assert less.none >= more.none - 1e-6 > 0.0
    assert found[-2].mean == pytest.approx(found[-1].mean, rel=0.01)


def test_a_load_between_two_of_the_table_is_as_if_solved() -> None:
    for load in (0.123, 0.5, 0.617, 0.935):
        between, solved = compute_waiting(3.0, 3.0, 1, load, 4), compute_chain_waiting(4, 1, load, 1.0)
        assert between.mean == pytest.approx(3.0 * solved.mean, rel=0.02)
        assert between.variance == pytest.approx(9.0 * solved.variance, rel=0.02)
        assert between.none == pytest.approx(solved.none, abs=0.005)


@pytest.mark.parametrize(("others", "cores", "load"), [(2, 1, 0.5), (4, 1, 0.4), (4, 1, 0.6), (6, 2, 0.6)])
def test_the_percentiles_are_those_of_simulated_tasks(others: int, cores: int, load: float) -> None:
    """Tasks whose jobs are all alike and wait for each other: 10 % at p50, 12 % at p95 and p99."""
    times = simulate_tasks(others, cores, load, 4000)
    steady = ServiceTime(p50=1.0, p95=1.0)
    found = estimate_latency(steady, HostLoad(float(cores), load * cores, others), None, 0.0)
    for predicted_ms, share, error in ((found.p50_ms, 0.5, 0.10), (found.p95_ms, 0.95, 0.12), (found.p99_ms, 0.99, 0.12)):  # fmt: skip
        assert predicted_ms / 1e3 == pytest.approx(times[int(share * len(times))], rel=error)


def simulate_tasks(others: int, cores: int, load: float, count: int) -> list[float]:
    """The sorted times of ``count`` jobs of 1 s, a while after each other, among tasks with jobs of 1 s."""
    random, found = Random(3), list[float]()
    rate = load * cores / others
    due = [random.expovariate(rate) for _ in range(others)]
    work, begins = [0.0] * others, 8.0  # what is left of all jobs of each task
    now, own, began = 0.0, 0.0, 0.0
    while len(found) < count:
        busy = [each for each in range(others) if work[each] > 0.0]
        here = len(busy) + (own > 0.0)
        speed = min(1.0, cores / here) if here else 0.0
        ends = now + min([work[each] for each in busy] + [own] * (own > 0.0)) / speed if here else inf
        step = min(ends, *due, begins)
        for each in busy:
            work[each] = max(0.0, work[each] - (step - now) * speed)
            work[each] *= work[each] > 1e-9
        own = max(0.0, own - (step - now) * speed)
        now = step
        if began and own < 1e-9:
            found.append(now - began)
            own, began, begins = 0.0, 0.0, now + random.expovariate(1.0 / 8.0)
        if now == begins:
            own, began, begins = 1.0, now, inf
        for each in range(others):
            if now == due[each]:
                work[each] += 1.0
                due[each] = now + random.expovariate(rate)
    return sorted(found)
