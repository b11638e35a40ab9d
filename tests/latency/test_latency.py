# SPDX-License-Identifier: Apache-2.0
"""The short form of make latency: one placement whose link takes most of the time, and the choice between links."""

import os
from collections.abc import Iterator
from dataclasses import replace

import pytest

from edgectl.config.weights import parse_weights
from edgectl.model.policy import Policy
from edgectl.model.predicted_latency import ServiceTime
from tests.latency.bench import Bench, Frame, Link, Site, build_task, decide, make_benches
from tests.latency.tables import FAST, PERIOD_S, SLOW, measure_rows
from tests.network_hosts import find_missing_for_counters
from tests.pace import patience

pytestmark = pytest.mark.skipif(bool(find_missing_for_counters()), reason=find_missing_for_counters() or "-")
SMALL = Frame(width=176, height=132)


@pytest.fixture
def bench() -> Iterator[Bench]:
    with make_benches(1) as [found]:
        # The core with the other one: the tests beside this one take their share of either.
        yield replace(found, other=min(os.sched_getaffinity(0)))


def test_a_slow_link_is_predicted_and_measured(bench: Bench) -> None:
    """23 kB at 2 Mbit/s are 97 ms; a busy machine adds to what is measured, and to the service time too."""
    [row] = measure_rows(bench, jobs=20, cases=[(SMALL, Link(rate=2e6), 0.0)])
    assert row.predicted.transfer_ms == pytest.approx(97.0 + 4.4, abs=6.0)
    assert row.measured.percentile_ms(0.50) >= 0.9 * row.predicted.transfer_ms
    # The service time was measured a moment before, which on a busy machine may have been a bad one.
    busy_s = patience(0.03)
    assert abs(row.predicted.p50_ms / 1e3 - row.measured.percentile_ms(0.50) / 1e3) <= busy_s


def test_the_faster_link_is_chosen_for_the_deadline_and_keeps_it_more_often(bench: Bench) -> None:
    frame, sites = Frame(width=240, height=180), [Site(link=SLOW, used=0.0, rtt_ms=0.1), Site(link=FAST, used=0.22, rtt_ms=0.1)]  # fmt: skip
    service = ServiceTime(p50=0.020, p95=0.022)  # as on an idle core: the choice is no matter of this machine
    task = build_task(frame, service, service.p50 + 0.030, period=PERIOD_S)
    chosen = [decide(task, sites, Policy(weights=parse_weights(name)))[0] for name in ("all", "latency")]
    assert chosen == [0, 1]
    late = []
    for link in (SLOW, FAST):
        bench.shape(link)
        # The least disturbed ones: what the tests beside this one take is no matter of the link.
        late.append(bench.measure(frame, 0.0, 1.0, jobs=20, think=0.05).percentile_ms(0.1))
    assert late[1] < late[0]
