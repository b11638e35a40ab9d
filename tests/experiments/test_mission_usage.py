# SPDX-License-Identifier: Apache-2.0
"""Usage over a mission from counters: numbers computed by hand."""

from collections.abc import Mapping
from dataclasses import replace

import pytest

from edgectl.experiments.mission_usage import UsageCounters
from edgectl.experiments.model.experiment import MissionUsage
from edgectl.model.snapshot import DeviceSample, Snapshot, UsageTotals
from tests.builders import NOW, a_sample, silent


def a_snapshot(at: float, memory: float = 0.0, **totals: UsageTotals | None) -> Snapshot:
    idle = a_sample()
    usage = {**idle.usage, "memory": replace(idle.usage["memory"], used=memory)}
    hosts = {
        name: replace(idle, usage=usage, totals=found) if found else silent()
        for name, found in totals.items()
    }
    return Snapshot(taken_at=NOW + at, hosts=hosts)


def of_host(cpu_s: float, network_bytes: float = 0.0) -> UsageTotals:
    return UsageTotals(cpu_s=cpu_s, network_bytes=network_bytes)


def of_slice(**tasks: float) -> UsageTotals:
    return UsageTotals(tasks=tasks)


def compute_usage(*snapshots: Snapshot, ended: float) -> Mapping[str, MissionUsage]:
    counters = UsageCounters()
    for snapshot in snapshots:
        counters.record_snapshot(snapshot)
    return counters.compute_usage(NOW, NOW + ended)


def test_a_short_mission_between_two_readings_counts_in_full() -> None:
    """The mission ends 3 s after the start, and is seen to have ended 2 s later; the host goes on with 0.1 cores."""
    found = compute_usage(
        a_snapshot(0.0, zeta=of_host(100.0, 1e6)),
        a_snapshot(5.0, zeta=of_host(103.2, 9e6)),
        a_snapshot(10.0, zeta=of_host(103.7, 9.5e6)),
        ended=3.0,
    )
    assert found["zeta"].cpu_s == pytest.approx(3.2 - 2 * 0.1)
    assert found["zeta"].network_bytes == pytest.approx(8e6 - 2 * 1e5)


def test_a_counter_that_is_a_little_lower_has_not_begun_anew() -> None:
    """What is recorded of an ended task may be less than its processes showed before; a restart is far lower."""
    found = compute_usage(
        a_snapshot(0.0, zeta=of_slice()),
        a_snapshot(2.0, zeta=of_slice(i1=3.22, i2=3.0)),
        a_snapshot(4.0, zeta=of_slice(i1=3.2, i2=0.4)),
        a_snapshot(6.0, zeta=of_slice(i1=3.2, i2=0.4)),
        ended=6.0,
    )
    assert found["zeta"].cpu_s == pytest.approx(3.22 + 3.4)


def test_a_mission_without_an_end_counts_up_to_its_limit() -> None:
    found = compute_usage(
        a_snapshot(0.0, zeta=of_host(1.0)),
        a_snapshot(5.0, zeta=of_host(3.0)),
        a_snapshot(10.0, zeta=of_host(5.0)),
        ended=6.0,
    )
    assert found["zeta"].cpu_s == pytest.approx(2.4)


def test_a_reboot_starts_counters_anew_and_a_silent_host_keeps_them() -> None:
    found = compute_usage(
        a_snapshot(0.0, zeta=of_host(50.0)),
        a_snapshot(2.0, zeta=of_host(52.0)),
        a_snapshot(4.0, zeta=None),
        a_snapshot(6.0, zeta=of_host(1.0)),
        a_snapshot(8.0, zeta=of_host(1.0)),
        ended=6.0,
    )
    assert found["zeta"].cpu_s == pytest.approx(3.0)


def test_tasks_of_a_slice_count_from_their_start_and_stay_counted_when_they_are_gone() -> None:
    found = compute_usage(
        a_snapshot(0.0, yard=of_slice(earlier=7.0), axle=of_slice()),
        a_snapshot(2.0, yard=of_slice(earlier=7.0, slam=1.5), axle=of_slice()),
        a_snapshot(4.0, yard=of_slice(), axle=of_slice(slam2=0.5)),
        a_snapshot(5.0, yard=of_slice(), axle=of_slice(slam2=0.5)),
        ended=4.0,
    )
    assert (found["yard"].cpu_s, found["axle"].cpu_s) == (1.5, 0.5)
    assert found["yard"].network_bytes is None


def test_memory_is_that_of_the_mission_and_not_of_the_idle_hosts_around_it() -> None:
    """100 until 2 s, then up to 300 at 4 s, and so until the end at 5 s."""
    counted = [of_host(float(second)) for second in range(5)]
    found = compute_usage(
        *(
            a_snapshot(at, memory, zeta=total)
            for at, memory, total in zip(
                (0.0, 2.0, 4.0, 6.0, 8.0), (10.0, 100.0, 300.0, 20.0, 10.0), counted, strict=True
            )
        ),
        ended=5.0,
    )
    assert found["zeta"].memory == pytest.approx((2 * 100 + 2 * 200 + 300) / 5)


def test_a_host_that_answered_once_has_no_usage() -> None:
    assert compute_usage(a_snapshot(0.0, zeta=of_host(1.0)), ended=5.0) == {}


def a_drawing_snapshot(at: float, **watts: float | None) -> Snapshot:
    """A snapshot in which hosts draw so many watts; None: no sensor tells."""
    snapshot = a_snapshot(at, 0.0, **dict.fromkeys(watts, of_host(at)))
    hosts = {
        name: replace(sample, device=DeviceSample(power_w=watts[name]))
        for name, sample in snapshot.hosts.items()
    }
    return replace(snapshot, hosts=hosts)


def test_energy_is_the_mean_draw_by_the_time_of_the_mission() -> None:
    """10 W until 2 s, 30 W from 4 s to the end at 5 s; 90 W before the mission do not count."""
    given = ((0.0, 90.0), (2.0, 10.0), (4.0, 30.0), (6.0, 80.0))
    found = compute_usage(*(a_drawing_snapshot(at, zeta=watts) for at, watts in given), ended=5.0)
    assert found["zeta"].energy == pytest.approx(2 * 10 + 2 * 20 + 1 * 30)


def test_a_host_that_tells_no_draw_at_times_has_no_energy() -> None:
    given = ((0.0, 10.0), (2.0, None), (4.0, 10.0))
    found = compute_usage(*(a_drawing_snapshot(at, zeta=watts) for at, watts in given), ended=4.0)
    assert found["zeta"].energy is None
