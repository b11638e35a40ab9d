# SPDX-License-Identifier: Apache-2.0
"""Readings of links: what lowers a capacity, for how long, and which idle links are probed next."""

from dataclasses import replace
from itertools import product

import pytest

from edgectl.model.link_reading import LinkHistory, LinkObservation, LinkReading, LinkSampleResult
from edgectl.model.snapshot import CapacitySource, InterfaceSample, LinkSample
from edgectl.rules import live_links
from edgectl.rules.link_turns import choose_links_to_probe
from edgectl.rules.live_links import (
    MAX_READING_AGE_S,
    add_sample,
    apply_live_capacities,
    compute_live_link,
    observe_link,
)
from tests.builders import (
    NOW,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)
from tests.scheduler.fleets import hosts_by_task, run_assign

DECLARED = LinkSample(capacity_bytes_per_s=6e6, used_bytes_per_s=0.0, capacity_source=CapacitySource.DECLARED)
NEW = LinkHistory()


def carry(known: LinkHistory, rate: float, now: float = 0.0) -> LinkHistory:
    return observe_link(known, LinkObservation(used_bytes_per_s=rate, carries_bytes_per_s=rate), now)


def live(
    known: LinkHistory, link: LinkSample = DECLARED, *, radio: float | None = None, now: float = 0.0
) -> float:
    return compute_live_link(link, known, radio, now).capacity_bytes_per_s


def test_only_edges_with_a_reading_a_cut_or_a_radio_are_looked_at() -> None:
    """As many links are computed as such an edge has; the samples of the others are the very same."""
    edges = {f"edge{n}": a_sample(links={"robot1": DECLARED, "robot2": DECLARED}) for n in (4, 3, 2, 1)}
    seen = replace(a_snapshot(), hosts=edges)
    assert apply_live_capacities(seen, {("edge1", "robot1"): LinkHistory(answered=True)}, {}, 0.0) is seen
    histories = {("edge3", "robot1"): carry(NEW, 1e6), ("edge2", "robot2"): replace(NEW, cut_off=True)}
    radio = {("edge1", "robot1"): LinkObservation(radio_bytes_per_s=2e6)}
    found = apply_live_capacities(seen, histories, radio, 0.0).hosts
    assert list(found) == list(edges)
    assert [name for name in edges if found[name] is edges[name]] == ["edge4"]
    rates = {
        name: [link.capacity_bytes_per_s for link in each.links.values()] for name, each in found.items()
    }
    assert rates == {"edge4": [6e6, 6e6], "edge3": [1e6, 6e6], "edge2": [6e6, 0.0], "edge1": [2e6, 6e6]}


def test_the_mean_of_the_last_two_readings_lowers_the_declared_capacity() -> None:
    """2 alone: 2. Then 3: 2.5. Then 1: (3 + 1) / 2 = 2. Then 1 again: 1. Then 13: 7, but not above the declared 6."""
    known, found = NEW, []
    for rate in (2e6, 3e6, 1e6, 1e6, 13e6):
        known = carry(known, rate)
        found.append(live(known))
    assert found == [2e6, 2.5e6, 2e6, 1e6, 6e6]


def test_a_robot_that_answered_and_falls_silent_for_three_probes_and_five_seconds_is_cut_off() -> None:
    def follow(*answers: bool | None, step: float = 2.5) -> float:
        known = NEW
        for number, answered in enumerate(answers):
            known = observe_link(known, LinkObservation(answered=answered), number * step)
        return live(known, now=(len(answers) - 1) * step)

    assert follow(True, None, None) == 6e6
    assert follow(True, None, None, None) == follow(True, None, False, None) == 0.0
    assert follow(True, None, None, None, step=0.1) == 6e6, "three probes of one moment"
    assert follow(True, None, None, None, True) == follow(True, None, None, True, None) == 6e6
    assert follow(None, None, None, None) == 6e6, "behind a firewall it never answers"


def test_a_link_that_says_nothing_new_would_be_left_as_it_is() -> None:
    """By all that is looked at otherwise."""
    one = LinkReading(bytes_per_s=1e6, at=0.0, source=CapacitySource.TCP)
    histories = [
        LinkHistory(
            readings=readings,
            answered=answered,
            silent=silent,
            silent_since=since,
            cut_off=cut_off,
            fell_at=fell,
        )
        for readings, answered, silent, since, cut_off, fell in product(
            [(), (one,), (one, replace(one, at=1.0))],
            [False, True],
            [0, 1],
            [0.0, 1.0],
            [False, True],
            [0.0, 1.0],
        )
    ]
    observations = [
        LinkObservation(used_bytes_per_s=used, carries_bytes_per_s=carries, answered=answered)
        for used, carries, answered in product([0.0, 9e5, 3e6], [None, 0.0, 1e6], [None, False, True])
    ]
    skipped = 0
    for known, seen in product(histories, observations):
        if live_links.says_nothing_new(known, seen):
            noted, rate = live_links._note_answer(known, seen, 9.0), seen.used_bytes_per_s
            assert live_links._refute_readings(live_links._confirm_fall(noted, rate), rate, 9.0) == known
            assert not seen.carries_bytes_per_s
            skipped += 1
    # Never answered and still silent (None, False), or answered as before: at 3 rates, 2 ways to carry nothing, fell or not.
    assert skipped == 3 * 3 * 2 * 2


def test_source_age_and_nominal_capacity_are_told() -> None:
    link = compute_live_link(DECLARED, carry(NEW, 2e6, now=100.0), None, 107.5)
    assert (link.capacity_source, link.capacity_age_s, link.nominal) == (CapacitySource.TCP, 7.5, 6e6)


def test_a_reading_is_forgotten_when_it_is_old_or_of_the_future() -> None:
    known = carry(NEW, 2e6, now=1000.0)
    assert live(known, now=1000.0 + MAX_READING_AGE_S) == 2e6
    assert live(known, now=1001.0 + MAX_READING_AGE_S) == 6e6
    assert live(known, now=999.0) == 6e6


def test_traffic_without_a_limit_refutes_a_reading_that_it_reaches() -> None:
    known = carry(NEW, 2e6)
    assert live(observe_link(known, LinkObservation(used_bytes_per_s=1.7e6), 1.0)) == 2e6
    assert live(observe_link(known, LinkObservation(used_bytes_per_s=1.9e6), 1.0)) == 6e6
    assert live(add_sample(known, LinkSampleResult(bytes_per_s=5e6), None, 1.0)) == 6e6
    assert live(add_sample(known, LinkSampleResult(), None, 1.0)) == 2e6


def test_a_measured_capacity_gives_way_to_a_newer_reading_and_a_dead_link_to_none() -> None:
    measured = replace(DECLARED, capacity_source=CapacitySource.MEASURED)
    assert live(carry(NEW, 9e6), measured) == 9e6
    dead = replace(DECLARED, capacity_bytes_per_s=0.0)
    assert compute_live_link(dead, carry(NEW, 2e6), 1e6, 0.0) == dead


def test_an_absurd_report_leaves_a_capacity_to_compute_with() -> None:
    assert live(carry(NEW, 1e-310)) == live(NEW, radio=1e-310) == 1.0
    assert live(carry(NEW, 1e300)) == 6e6


def test_the_rate_of_a_radio_is_a_bound_too() -> None:
    link = compute_live_link(DECLARED, carry(NEW, 4e6), 3e6, 0.0)
    assert (link.capacity_bytes_per_s, link.capacity_source) == (3e6, CapacitySource.RADIO)
    assert live(carry(NEW, 2e6), radio=3e6) == 2e6
    assert live(NEW, radio=30e6) == 6e6


FLEET = an_inventory(
    an_edge("edge1"), an_edge("edge2"), a_robot("robot1"), a_robot("robot2"), a_robot("robot3", probe=False)
)
PAIRS = [(edge, robot) for edge in ("edge1", "edge2") for robot in ("robot1", "robot2", "robot3")]
SEEN = {pair: LinkObservation(interface="eth0", rtt_ms=1.0) for pair in PAIRS}
LINKS = dict.fromkeys(("robot1", "robot2", "robot3"), DECLARED)
SNAPSHOT = a_snapshot(
    edge1=a_sample(links=LINKS), edge2=a_sample(links=LINKS), robot1=a_sample(), robot2=a_sample()
)


def probed(at: float, rtt_ms: float = 1.0, *, refused: bool = False) -> LinkHistory:
    return LinkHistory(sampled_at=at, rtt_ms=rtt_ms, refused=refused)


def test_links_take_turns_and_no_two_share_a_host() -> None:
    assert choose_links_to_probe(FLEET, SNAPSHOT, {}, SEEN, 1000.0) == (
        ("edge1", "robot1"),
        ("edge2", "robot2"),
    )
    known = {("edge1", "robot1"): probed(900.0), ("edge2", "robot2"): probed(900.0)}
    assert choose_links_to_probe(FLEET, SNAPSHOT, known, SEEN, 1000.0) == (
        ("edge1", "robot2"),
        ("edge2", "robot1"),
    )


def test_no_host_takes_part_more_often_than_every_nine_seconds() -> None:
    known = {
        ("edge1", "robot1"): probed(1000.0),
        ("edge1", "robot2"): probed(990.0),
        ("edge2", "robot1"): probed(980.0),
        ("edge2", "robot2"): probed(970.0),
    }
    assert choose_links_to_probe(FLEET, SNAPSHOT, known, SEEN, 1008.9) == (("edge2", "robot2"),)
    assert len(choose_links_to_probe(FLEET, SNAPSHOT, known, SEEN, 1009.1)) == 2


def test_a_link_with_longer_round_trips_comes_first() -> None:
    known = {pair: probed(900.0 if pair == ("edge2", "robot1") else 100.0) for pair in PAIRS}
    slow = {**SEEN, ("edge2", "robot1"): LinkObservation(interface="eth0", rtt_ms=9.0)}
    assert choose_links_to_probe(FLEET, SNAPSHOT, known, slow, 1000.0)[0] == ("edge2", "robot1")


@pytest.mark.parametrize(
    ("seen", "sample"),
    [
        (LinkObservation(interface="eth0", used_bytes_per_s=0.4e6), a_sample()),
        (LinkObservation(interface="lo"), a_sample()),
        (LinkObservation(), a_sample()),
        (LinkObservation(interface="eth0"), silent()),
        (
            LinkObservation(interface="eth0"),
            replace(
                a_sample(),
                device=replace(
                    a_sample().device,
                    interfaces={"wlan0": InterfaceSample(rx_bytes_per_s=0.0, tx_bytes_per_s=0.4e6)},
                ),
            ),
        ),
    ],
    ids=["busy", "this machine", "unknown route", "silent robot", "robot busy with UDP"],
)
def test_a_link_is_left_alone(seen: LinkObservation, sample: object) -> None:
    snapshot = replace(SNAPSHOT, hosts={**SNAPSHOT.hosts, "robot1": sample})  # type: ignore[dict-item]
    assert choose_links_to_probe(FLEET, snapshot, {}, {("edge1", "robot1"): seen}, 1000.0) == ()


def test_a_link_that_lets_no_probe_through_is_tried_again_after_ten_minutes() -> None:
    only, known = (
        {("edge1", "robot1"): SEEN["edge1", "robot1"]},
        {("edge1", "robot1"): probed(1000.0, refused=True)},
    )
    assert choose_links_to_probe(FLEET, SNAPSHOT, known, only, 1599.0) == ()
    assert choose_links_to_probe(FLEET, SNAPSHOT, known, only, 1601.0)


def test_a_task_moves_away_from_an_edge_that_is_cut_off_from_its_robot() -> None:
    run = a_run(spec_hash="hash-slam", started_at=NOW - 900.0)
    seen = a_snapshot(
        edge1=a_sample(links={"robot1": DECLARED}, tasks={"slam": run}),
        edge2=a_sample(used=2.0, links={"robot1": DECLARED}),
    )
    fleet = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1", probe=False))
    tasks = some_tasks(a_task("slam", cpu=1.0, throughput=1e5, robots=["robot1"]))

    def place_after(silent_probes: int) -> str | None:
        known = observe_link(NEW, LinkObservation(answered=True), NOW - 60.0)
        for number in range(silent_probes):
            known = observe_link(known, LinkObservation(), NOW - 50.0 + number * 10.0)
        snapshot = apply_live_capacities(seen, {("edge1", "robot1"): known}, {}, NOW)
        return hosts_by_task(run_assign(fleet, tasks, snapshot))["slam"]

    assert (place_after(2), place_after(3)) == ("edge1", "edge2")
