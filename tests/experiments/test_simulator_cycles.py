# SPDX-License-Identifier: Apache-2.0
"""Flows of items on shared hosts and links: closed forms, conservation, and a simulation of every item."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from edgectl.experiments.simulator_cycles import Customer, Station, compute_flows
from edgectl.experiments.simulator_flows import compute_mean_age_s
from tests.experiments.item_simulation import Program, simulate_items

DETECT, LEARN, FRAME = 0.036, 0.010, 64e3
NEAR, FAR = 2e6, 2e5


def test_alone_an_item_takes_what_it_needs() -> None:
    """0.2 s on the link, 0.1 s of work on half a core: 2.5 a second."""
    (flow,) = compute_flows((Station(1e6), Station(0.5, width=1.0)), (Customer(10.0, ((0, 2e5), (1, 0.1))),))
    assert (flow.rate, flow.age) == pytest.approx((2.5, 0.4), rel=1e-4)


def test_no_more_than_its_rate() -> None:
    (flow,) = compute_flows((Station(4.0, width=1.0),), (Customer(5.0, ((0, 0.01),)),))
    assert (flow.rate, flow.age) == pytest.approx((5.0, 0.01), rel=1e-3)


def test_one_program_uses_one_core() -> None:
    (flow,) = compute_flows((Station(4.0, width=1.0),), (Customer(100.0, ((0, 0.1),)),))
    assert flow.rate == pytest.approx(10.0)


def test_equal_customers_share_a_full_station() -> None:
    """Four that need the whole station all the time get a quarter each."""
    flows = compute_flows((Station(1.0),), (Customer(10.0, ((0, 1.0),)),) * 4)
    assert [flow.rate for flow in flows] == pytest.approx([0.25] * 4, rel=0.01)


def test_work_below_the_quota_is_done_in_one_burst() -> None:
    """25 ms of a quota of 30 ms: at full speed, whatever the share of a core is; 120 ms need four periods."""
    host = (Station(0.3, width=1.0, period=0.1),)
    assert compute_flows(host, (Customer(1.0, ((0, 0.025),)),))[0].age == pytest.approx(0.025, rel=1e-3)
    assert 0.3 <= compute_flows(host, (Customer(1.0, ((0, 0.12),)),))[0].age <= 0.4


SYSTEMS = {
    "one, far from the edge": ({"e": (0.45, 0)}, [(5, "e", FAR, DETECT)]),
    "two, near": ({"e": (0.45, 0)}, [(5, "e", NEAR, DETECT)] * 2),
    "two on an edge that is too slow for them": ({"e": (0.3, 0)}, [(5, "e", NEAR, DETECT)] * 2),
    "beside two strangers": ({"e": (0.45, 2)}, [(5, "e", FAR, DETECT)]),
    "three edges": (
        {"z": (0.45, 2), "y": (0.35, 0), "x": (0.3, 0)},
        [(5, "z", FAR, DETECT), (5, "y", NEAR, DETECT), (5, "y", NEAR, LEARN), (5, "x", FAR, DETECT)],
    ),
    "four on one edge": (
        {"e": (0.45, 0)},
        [(5, "e", NEAR, DETECT), (5, "e", NEAR, DETECT), (5, "e", FAR, DETECT), (5, "e", FAR, LEARN)],
    ),
    "all of a robot on itself": (
        {"r": (0.11, 0)},
        [(5, "r", 1e12, DETECT), (5, "r", 1e12, LEARN), (10, "r", 1e12, 0.0015), (5, "r", 1e12, 0.002)],
    ),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_rates_are_those_of_a_simulation_of_every_item(name: str) -> None:
    """Within 12 %: the model takes items as coming at random moments of a period, real ones fall into step."""
    hosts, tasks = SYSTEMS[name]
    links = {f"{host} {number}": carries for number, (_, host, carries, _) in enumerate(tasks)}
    programs = [
        Program(rate, [(f"{host} {number}", FRAME if cpu == DETECT else 1500.0), (host, cpu)])
        for number, (rate, host, _, cpu) in enumerate(tasks)
    ]
    expected = simulate_items(hosts, links, programs, seconds=20.0)
    names = [*hosts, *links]
    stations = (
        *(Station(cores, width=1.0, period=0.1, rivals=rivals) for cores, rivals in hosts.values()),
        *(Station(carries) for carries in links.values()),
    )
    customers = tuple(
        Customer(program.rate, tuple((names.index(at), work) for at, work in program.work))
        for program in programs
    )
    found = compute_flows(stations, customers)
    assert [flow.rate for flow in found] == pytest.approx([rate for rate, _ in expected], rel=0.12)


@given(
    st.lists(st.tuples(st.floats(0.1, 50), st.floats(1e-4, 0.5), st.integers(0, 2)), min_size=1, max_size=6),
    st.floats(0.05, 4.0),
    st.sampled_from([0.0, 0.1]),
    st.integers(0, 2),
)
@example([(0.25, 0.0001, 0)], 1.0, 0.0, 0)
def test_no_station_gives_more_than_it_has(
    tasks: list[tuple[float, float, int]], cores: float, period: float, rivals: int
) -> None:
    stations = (Station(cores, width=1.0, period=period, rivals=rivals), Station(1.0), Station(0.2))
    customers = tuple(Customer(rate, ((at, work), (0, work))) for rate, work, at in tasks)
    flows = compute_flows(stations, customers)
    used = [0.0] * 3
    for customer, flow in zip(customers, flows, strict=True):
        assert 0 < flow.rate <= customer.rate * (1 + 1e-9)
        assert flow.age >= sum(work for _, work in customer.work) * 0.99
        for at, work in customer.work:
            used[at] += flow.rate * work
    assert all(share <= station.capacity * 1.02 for share, station in zip(used, stations, strict=True))


@given(st.floats(0.0, 2.0), st.floats(0.01, 2.0), st.floats(0.01, 2.0))
def test_the_mean_age_is_that_of_many_moments(youngest: float, grows: float, least: float) -> None:
    moments = [youngest + grows * (moment + 0.5) / 1000 for moment in range(1000)]
    mean = sum(max(age, least) for age in moments) / len(moments)
    assert compute_mean_age_s(youngest, youngest + grows, least) == pytest.approx(mean, rel=1e-3)
