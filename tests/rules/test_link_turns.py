# SPDX-License-Identifier: Apache-2.0
"""Turns of idle links: what urges, and what the budget of each host leaves."""

import random
from dataclasses import replace

import pytest

from edgectl.model.latency import LatencySample
from edgectl.model.link_reading import LinkHistory, LinkObservation, LinkReading, LinkSampleResult
from edgectl.model.snapshot import CapacitySource, InterfaceSample, LinkSample, Snapshot
from edgectl.rules.link_turns import LinkUse, choose_links_to_probe, find_link_use, split_into_rounds
from edgectl.rules.live_links import (
    BUDGET_S,
    FRESH_S,
    MAX_SAMPLES,
    add_sample,
    apply_live_capacities,
    compute_live_link,
    forget_former_readings,
    observe_link,
)
from tests.builders import a_robot, a_run, a_sample, a_snapshot, an_edge, an_inventory

Pair = tuple[str, str]
NOMINAL = LinkSample(capacity_bytes_per_s=2e6, used_bytes_per_s=0.0, capacity_source=CapacitySource.DECLARED)
# In reverse alphabetical order, as inventories may be.
EDGES, ROBOTS = ("edge3", "edge2", "edge1"), ("robot4", "robot3", "robot2", "robot1")
FLEET = an_inventory(*(an_edge(name) for name in EDGES), *(a_robot(name) for name in ROBOTS))
PAIRS = [(edge, robot) for edge in EDGES for robot in ROBOTS]
SEEN = {pair: LinkObservation(interface="eth0", rtt_ms=1.0) for pair in PAIRS}
# Its detection sends at 200 kB/s over the link to edge1.
SENDING = replace(
    a_sample(),
    device=replace(
        a_sample().device, interfaces={"wlan0": InterfaceSample(rx_bytes_per_s=0.0, tx_bytes_per_s=2e5)}
    ),
)
NOW = 1000.0


def a_site(histories: dict[Pair, LinkHistory]) -> Snapshot:
    links = dict.fromkeys(ROBOTS, NOMINAL)
    edges = {edge: a_sample(links=links) for edge in EDGES}
    robots = {robot: SENDING if robot == "robot1" else a_sample() for robot in ROBOTS}
    return apply_live_capacities(replace(a_snapshot(), hosts={**edges, **robots}), histories, {}, NOW)


def at(*times: float, fell: float = 0.0, rates: tuple[float, ...] = ()) -> LinkHistory:
    return LinkHistory(
        sampled_at=times[-1],
        sampled_before=times[:-1],
        fell_at=fell,
        readings=tuple(
            LinkReading(bytes_per_s=rate, at=fell or times[-1], source=CapacitySource.TCP) for rate in rates
        ),
    )


def choose(changed: dict[Pair, LinkHistory], use: LinkUse | None) -> set[Pair]:
    """All links were probed 100 s ago, but for ``changed``."""
    known = {pair: at(NOW - 100.0) for pair in PAIRS} | changed
    return set(choose_links_to_probe(FLEET, a_site(known), known, SEEN, NOW, use))


ON_EDGE1 = LinkUse(used={("edge1", "robot1")}, served={"robot1"})
FALLEN = at(NOW - 100.0, fell=NOW, rates=(2e5,))
OTHERS_OF_ROBOT1 = {("edge2", "robot1"), ("edge3", "robot1")}


def of_robot1(pairs: set[Pair]) -> set[Pair]:
    return {pair for pair in pairs if pair[1] == "robot1"}


@pytest.mark.parametrize(
    ("changed", "use", "expected"),
    [
        pytest.param({}, ON_EDGE1, set(), id="a robot that sends is left alone"),
        pytest.param(
            {("edge1", "robot1"): FALLEN}, ON_EDGE1, OTHERS_OF_ROBOT1, id="its link fell: all others at once"
        ),
        pytest.param(
            {("edge1", "robot1"): FALLEN, ("edge2", "robot1"): at(NOW)},
            ON_EDGE1,
            {("edge3", "robot1")},
            id="once for each fall; edge2 was probed since, edge3 has a budget of its own",
        ),
        pytest.param(
            {("edge1", "robot1"): FALLEN, ("edge3", "robot4"): at(NOW - 20.0, NOW - 10.0, NOW - 1.0)},
            ON_EDGE1,
            {("edge2", "robot1")},
            id="three probes of edge3 in 27 s",
        ),
        pytest.param(
            {("edge1", "robot1"): FALLEN, ("edge3", "robot4"): at(NOW - 27.0, NOW - 10.0, NOW - 1.0)},
            ON_EDGE1,
            OTHERS_OF_ROBOT1,
            id="the first of three is 27 s ago",
        ),
        pytest.param(
            {
                ("edge1", "robot1"): FALLEN,
                ("edge2", "robot1"): at(NOW - 40.0, NOW - 30.0, fell=NOW - 5.0, rates=(2e5,)),
                ("edge1", "robot2"): at(NOW - 20.0, NOW - 10.0),
                ("edge3", "robot1"): at(NOW - 26.0, NOW - 25.0),
            },
            ON_EDGE1,
            {("edge3", "robot1")},
            id="robot1 has one left: edge2 was read from traffic 5 s ago",
        ),
        pytest.param(
            {("edge1", "robot1"): replace(FALLEN, readings=())},
            ON_EDGE1,
            set(),
            id="it carries again what is declared",
        ),
        pytest.param(
            {("edge1", "robot1"): FALLEN}, LinkUse(), set(), id="a fall where no task of the robot is"
        ),
        pytest.param(
            {("edge1", "robot1"): at(NOW - 100.0, fell=NOW - 300.0, rates=(2e5,))},
            ON_EDGE1,
            {("edge2", "robot1")},
            id="suffers since long: one at a time",
        ),
        pytest.param(
            {("edge2", "robot1"): at(NOW - 40.0), ("edge3", "robot1"): at(NOW - 30.0, rates=(2e6, 1e6))},
            LinkUse(used={("edge1", "robot1")}, served={"robot1"}, late={"robot1"}),
            {("edge1", "robot1")},
            id="late: the oldest first",
        ),
        pytest.param(
            {
                ("edge1", "robot1"): at(NOW - 30.0),
                ("edge2", "robot1"): at(NOW - 40.0),
                ("edge3", "robot1"): at(NOW - 30.0, rates=(2e6, 1e6)),
            },
            LinkUse(used={("edge1", "robot1")}, served={"robot1"}, late={"robot1"}),
            {("edge3", "robot1")},
            id="late: 30 s that varied by half count as 45 s",
        ),
    ],
)
def test_what_urges_a_probe_of_the_links_of_a_robot(
    changed: dict[Pair, LinkHistory], use: LinkUse, expected: set[Pair]
) -> None:
    assert of_robot1(choose(changed, use)) == expected


def test_a_probe_for_its_turn_leaves_two_of_three_for_what_may_fall() -> None:
    recent = {(edge, "robot4"): at(NOW - 20.0) for edge in EDGES}
    assert choose(recent, ON_EDGE1) == set()
    assert choose(recent, None)


def test_links_of_robots_without_a_task_that_runs_wait_four_times_as_long() -> None:
    use = LinkUse(used={("edge1", "robot2")}, served={"robot2"})
    rest = {pair: at(NOW - 60.0) for pair in PAIRS}
    own = {(edge, "robot2"): at(NOW - 30.0) for edge in EDGES}
    assert ("edge1", "robot2") in choose(rest | own, use)


def test_a_fall_is_more_than_the_noise_of_two_readings_and_counts_once() -> None:
    """2 MB/s nominal: 1.5 is none, 0.2 is one (below 0.7 of 1.5), another 0.2 is none, and so is the rise."""
    known, falls = LinkHistory(), []
    for now, rate in enumerate((1.5e6, 0.2e6, 0.2e6, 2e6), start=1):
        seen = LinkObservation(used_bytes_per_s=rate, carries_bytes_per_s=rate)
        known = observe_link(known, seen, float(now), 2e6)
        falls.append(known.fell_at)
    assert falls == [0.0, 2.0, 2.0, 2.0]


@pytest.mark.parametrize(
    ("used", "counts"),
    [
        pytest.param(0.05e6, 1.1e6, id="too little to say so"),
        pytest.param(0.15e6, 0.2e6, id="three quarters of what was read"),
        pytest.param(0.19e6, 1.1e6, id="as much as was read: it may carry more"),
        pytest.param(1.0e6, 2e6, id="refuted"),
    ],
)
def test_traffic_that_stays_below_a_fall_confirms_it(used: float, counts: float) -> None:
    """2 MB/s, then 0.2: the mean is 1.1, until the first is forgotten."""
    known = LinkHistory()
    for now, rate in ((1.0, 2e6), (2.0, 0.2e6)):
        seen = LinkObservation(used_bytes_per_s=rate, carries_bytes_per_s=rate)
        known = observe_link(known, seen, now, 2e6)
    known = observe_link(known, LinkObservation(used_bytes_per_s=used), 3.0, 2e6)
    assert compute_live_link(NOMINAL, known, None, 3.0).capacity_bytes_per_s == counts


def test_a_fall_that_bursts_show_counts_at_once() -> None:
    """Of a connection that sends all the time, and of a rise, the mean with the reading before counts."""

    def read(*rates: tuple[float, float]) -> float:
        known = LinkHistory()
        for now, (used, carries) in enumerate(rates, start=1):
            seen = LinkObservation(used_bytes_per_s=used, carries_bytes_per_s=carries)
            known = observe_link(known, seen, float(now), 2e6)
        return compute_live_link(NOMINAL, known, None, float(len(rates))).capacity_bytes_per_s

    assert read((0.3e6, 1.7e6), (0.15e6, 0.2e6)) == 0.2e6
    assert read((0.3e6, 1.7e6), (0.2e6, 0.2e6)) == 0.95e6
    assert read((0.3e6, 1.7e6), (0.3e6, 0.2e6)) == 0.95e6, "the traffic says that it carries more"
    assert read((0.3e6, 1.7e6), (0.3e6, 1.3e6)) == 1.5e6, "no fall"
    assert read((0.15e6, 0.2e6), (0.3e6, 1.2e6)) == 0.7e6, "a rise"


def test_a_fall_makes_older_readings_of_other_links_of_the_robot_void() -> None:
    """It is somewhere else now. Readings of other robots stay, and those that were taken on the way."""
    far = at(NOW - FRESH_S - 1.0, rates=(2e5, 2e5))
    known = dict.fromkeys(PAIRS, far)
    known["edge1", "robot1"] = replace(at(NOW - 50.0, fell=NOW, rates=(2e5,)), fell_at=NOW)
    known["edge3", "robot1"] = at(NOW - FRESH_S + 1.0, rates=(2e5,))
    found = forget_former_readings(known, NOW)
    assert found["edge2", "robot1"] == replace(far, readings=())
    assert {pair for pair in PAIRS if found[pair] != known[pair]} == {("edge2", "robot1")}
    assert forget_former_readings(known, NOW + 2.0) == known, "once"


def test_links_that_were_read_just_before_a_fall_are_not_probed_for_it() -> None:
    """The robot's tasks have moved from a bad link to a worse one; of the one they left there is a reading."""
    fell = at(NOW - 100.0, fell=NOW - 1.0, rates=(2e5,))
    left = at(NOW - FRESH_S, rates=(2e5,))
    assert of_robot1(choose({("edge1", "robot1"): fell, ("edge2", "robot1"): left}, ON_EDGE1)) == {
        ("edge3", "robot1")
    }


def test_a_robot_that_is_cut_off_counts_as_fallen() -> None:
    known = observe_link(LinkHistory(), LinkObservation(answered=True), NOW - 30.0)
    for second in (20.0, 10.0, 0.0):
        known = observe_link(known, LinkObservation(), NOW - second)
    assert known.fell_at == NOW
    lost = replace(known, sampled_at=NOW - 100.0)
    assert of_robot1(choose({("edge1", "robot1"): lost}, ON_EDGE1)) == OTHERS_OF_ROBOT1


def test_use_is_read_from_what_runs_where() -> None:
    late = LatencySample(recent_count=20, recent_misses=2)
    snapshot = a_snapshot(
        edge2=a_sample(links={"robot2": NOMINAL}, tasks={"slam": replace(a_run(), latency=late)}),
        edge1=a_sample(links={"robot2": NOMINAL}, tasks={"other": a_run()}),
        robot1=a_sample(tasks={"local": a_run()}),
    )
    found = find_link_use(snapshot, {"slam": ["robot2"], "local": ["robot1"]})
    assert found == LinkUse(used={("edge2", "robot2")}, served={"robot1", "robot2"}, late={"robot2"})


def test_rounds_have_no_host_twice_and_keep_the_order() -> None:
    pairs = [("edge3", "robot1"), ("edge2", "robot1"), ("edge2", "robot2"), ("edge1", "robot1")]
    assert split_into_rounds(pairs) == [
        (("edge3", "robot1"), ("edge2", "robot2")),
        (("edge2", "robot1"),),
        (("edge1", "robot1"),),
    ]


@pytest.mark.parametrize("seed", range(6))
def test_no_host_exceeds_its_budget_and_every_link_gets_its_turn(seed: int) -> None:
    """A plan every 2 s for 20 minutes; links in use fall at random in the first half, in odd runs tasks are late."""
    dice = random.Random(seed)
    known: dict[Pair, LinkHistory] = {}
    probed: dict[str, list[float]] = {}
    last = dict.fromkeys(PAIRS, 600.0)
    use = LinkUse(
        used={(dice.choice(EDGES), robot) for robot in ROBOTS},
        served=set(ROBOTS[1:]),
        late={"robot2"} if seed % 2 else set(),
    )
    site = a_site({})
    hosts = {**site.hosts, "robot1": a_sample()}
    for step in range(600):
        now = NOW + 2.0 * step
        for pair in sorted(use.used):
            if step < 300 and dice.random() < 0.1:
                rate = dice.choice((2e5, 2e6))
                seen = LinkObservation(used_bytes_per_s=rate, carries_bytes_per_s=rate)
                known[pair] = observe_link(known.get(pair, LinkHistory()), seen, now, 2e6)
        live = apply_live_capacities(replace(site, hosts=hosts), known, {}, now)
        for pair in choose_links_to_probe(FLEET, live, known, SEEN, now, use):
            known[pair] = add_sample(
                known.get(pair, LinkHistory()), LinkSampleResult(bytes_per_s=2e6), 1.0, now
            )
            last[pair] = now
            for host in pair:
                probed.setdefault(host, []).append(now)
    for times in probed.values():
        assert all(
            later - first >= BUDGET_S for first, later in zip(times, times[MAX_SAMPLES:], strict=False)
        )
    assert min(last.values()) >= NOW + 1200.0 - 600.0, last
