# SPDX-License-Identifier: Apache-2.0
"""Smoothing on the manager: noise is averaged with time weights, and our own starts, stops and moves take
effect at once.
"""

import dataclasses
from dataclasses import replace

import pytest

from edgectl.gateway.smoothing import smooth_snapshot
from edgectl.model.resource import Usage
from edgectl.model.snapshot import DeviceSample, Snapshot, TaskState
from tests.builders import GI, NOW, a_link, a_run, a_sample, a_snapshot, silent

PERIOD = 10.0


def smooth_all(*snapshots: Snapshot) -> Snapshot:
    """Smooth each snapshot with the previous ones."""
    before: Snapshot | None = None
    for snapshot in snapshots:
        before = smooth_snapshot(before, snapshot, period=PERIOD)
    assert before is not None
    return before


def get_used_cores(snapshot: Snapshot, host: str = "edge1") -> float:
    return snapshot.hosts[host].usage["cpu"].used


def test_the_first_snapshot_is_taken_as_it_is() -> None:
    first = a_snapshot(edge1=a_sample(used=2.0))
    assert smooth_all(first) is first


def test_a_sample_one_period_later_weighs_three_tenths() -> None:
    link = {"robot1": a_link(used=1e6)}
    made = smooth_all(
        a_snapshot(edge1=a_sample(used=1.0, used_memory=1 * GI, links=link)),
        a_snapshot(
            taken_at=NOW + PERIOD,
            edge1=a_sample(
                used=2.0, used_memory=2 * GI, links={"robot1": a_link(used=2e6), "robot2": a_link(used=7.0)}
            ),
        ),
    )
    host = made.hosts["edge1"]
    assert get_used_cores(made) == pytest.approx(1.3)
    assert host.usage["memory"].used == pytest.approx(1.3 * GI)
    assert host.links["robot1"].used_bytes_per_s == pytest.approx(1.3e6)
    assert host.links["robot2"].used_bytes_per_s == 7.0


def test_links_that_are_as_before_are_the_same_and_the_traffic_of_a_task_that_ends_is_gone() -> None:
    idle = {"robot1": a_link(used=1e6), "robot2": a_link(used=0.0)}
    busy = replace(a_sample(links=idle), tasks={"t": a_run(links={"robot1": 1e6})})
    later = a_snapshot(taken_at=NOW + PERIOD, edge1=a_sample(links=dict(idle)))
    assert smooth_all(a_snapshot(edge1=a_sample(links=idle)), later).hosts["edge1"].links == idle
    ended = smooth_all(a_snapshot(edge1=busy), later).hosts["edge1"].links["robot1"]
    # The traffic is others' now: before there was none.
    assert ended.used_bytes_per_s == pytest.approx(0.3e6)


def test_a_copy_is_smoothed_and_takes_its_readings_along_when_it_becomes_active() -> None:
    made = smooth_all(
        a_snapshot(edge1=replace(a_sample(used=1.0), standbys={"t": a_run(used=Usage(cpu=0.5))})),
        a_snapshot(
            taken_at=NOW + PERIOD,
            edge1=replace(a_sample(used=2.0), standbys={"t": a_run(used=Usage(cpu=1.5))}),
        ),
        a_snapshot(
            taken_at=NOW + 2 * PERIOD, edge1=a_sample(used=2.0, tasks={"t": a_run(used=Usage(cpu=1.5))})
        ),
    )
    assert made.hosts["edge1"].tasks["t"].used["cpu"] == pytest.approx(0.8 + 0.3 * 0.7)
    # Others used 0.5 throughout.
    assert get_used_cores(made) == pytest.approx(0.5 + 0.8 + 0.3 * 0.7)
    assert not made.hosts["edge1"].standbys


def test_time_counts_not_the_number_of_samples() -> None:
    once = smooth_all(
        a_snapshot(edge1=a_sample(used=1.0)), a_snapshot(taken_at=NOW + 20, edge1=a_sample(used=2.0))
    )
    twice = smooth_all(
        a_snapshot(edge1=a_sample(used=1.0)),
        a_snapshot(taken_at=NOW + 13, edge1=a_sample(used=2.0)),
        a_snapshot(taken_at=NOW + 20, edge1=a_sample(used=2.0)),
    )
    assert get_used_cores(once) == pytest.approx(get_used_cores(twice)) == pytest.approx(2.0 - 0.7**2)


def test_a_clock_that_goes_back_counts_as_one_period() -> None:
    assert get_used_cores(
        smooth_all(
            a_snapshot(edge1=a_sample(used=1.0)), a_snapshot(taken_at=NOW - 3600, edge1=a_sample(used=2.0))
        )
    ) == pytest.approx(1.3)


def test_a_task_that_comes_or_goes_changes_the_load_at_once() -> None:
    task = a_run(used=Usage(cpu=1.0, memory=GI, network=1e6), links={"robot1": 1e6})
    idle = a_sample(used=0.5, used_memory=GI, links={"robot1": a_link(used=0.0)})
    busy = a_sample(used=1.5, used_memory=2 * GI, links={"robot1": a_link(used=1e6)}, tasks={"slam": task})
    for before, after, cores in ((idle, busy, 1.5), (busy, idle, 0.5)):
        made = smooth_all(a_snapshot(edge1=before), a_snapshot(taken_at=NOW + PERIOD, edge1=after)).hosts[
            "edge1"
        ]
        assert made.measured
        assert made.usage["cpu"].used == pytest.approx(cores)
        assert made.usage["memory"].used == pytest.approx(after.usage["memory"].used)
        assert made.links["robot1"].used_bytes_per_s == pytest.approx(after.links["robot1"].used_bytes_per_s)


def test_a_tasks_use_is_averaged_with_its_host_and_anew_after_a_restart() -> None:
    task = a_run(used=Usage(cpu=1.0, network=100.0), links={"robot1": 100.0})
    more = dataclasses.replace(task, used=Usage(cpu=2.0, network=200.0), links={"robot1": 200.0})
    first = a_snapshot(edge1=a_sample(used=1.0, tasks={"slam": task}))
    second = a_snapshot(taken_at=NOW + PERIOD, edge1=a_sample(used=2.0, tasks={"slam": more}))
    made = smooth_all(first, second).hosts["edge1"].tasks["slam"]
    assert (made.used["cpu"], made.used["network"]) == pytest.approx((1.3, 130.0))
    assert made.links == pytest.approx({"robot1": 130.0})
    assert get_used_cores(smooth_all(first, second)) == pytest.approx(1.3)
    for new in (
        dataclasses.replace(more, instance="instance-2"),
        dataclasses.replace(more, state=TaskState.COMPLETED),
    ):
        third = dataclasses.replace(second, hosts={"edge1": a_sample(used=2.0, tasks={"slam": new})})
        assert smooth_all(first, third).hosts["edge1"].tasks["slam"] == new


def test_a_host_that_returns_or_was_rebooted_starts_anew() -> None:
    first, back = (
        a_snapshot(edge1=a_sample(used=1.0)),
        a_snapshot(taken_at=NOW + 2 * PERIOD, edge1=a_sample(used=3.0)),
    )
    lost = a_snapshot(taken_at=NOW + PERIOD, edge1=silent())
    assert not smooth_all(first, lost).hosts["edge1"].ok
    assert get_used_cores(smooth_all(first, lost, back)) == 3.0
    rebooted = dataclasses.replace(
        back, hosts={"edge1": dataclasses.replace(a_sample(used=3.0), device=DeviceSample(boot_id="another"))}
    )
    assert get_used_cores(smooth_all(first, rebooted)) == 3.0


def test_what_a_resident_profiler_smoothed_is_not_smoothed_again() -> None:
    resident = dataclasses.replace(a_sample(used=3.0), resident=True)
    assert (
        get_used_cores(
            smooth_all(
                a_snapshot(edge1=a_sample(used=1.0)), a_snapshot(taken_at=NOW + PERIOD, edge1=resident)
            )
        )
        == 3.0
    )


def test_nothing_is_ever_negative() -> None:
    task = a_run(used=Usage(cpu=3.0, memory=3 * GI), links={"robot1": 5e6})
    busy = a_sample(used=0.5, used_memory=GI, links={"robot1": a_link(used=1e6)}, tasks={"slam": task})
    made = smooth_all(a_snapshot(edge1=busy), a_snapshot(taken_at=NOW + PERIOD, edge1=a_sample())).hosts[
        "edge1"
    ]
    assert made.measured
    assert (made.usage["cpu"].used, made.usage["memory"].used, made.links) == (0.0, 0.0, {})
