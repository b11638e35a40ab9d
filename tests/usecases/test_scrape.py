# SPDX-License-Identifier: Apache-2.0
"""Sharing one probe among concurrent requests."""

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.policy import Policy
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.scrape import RevisionCache, SharedCache, collect_fleet_metrics, keep_sessions_open
from tests.builders import NOW, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet


class CountingMaker:
    """Counts its calls; fails on request."""

    def __init__(self) -> None:
        self.made = 0
        self.fails = False

    def __call__(self) -> int:
        self.made += 1
        if self.fails:
            raise ValueError(str(self.made))
        return self.made


def test_a_value_is_kept_for_a_while() -> None:
    make, now = CountingMaker(), [100.0]
    shared = SharedCache(make, every=10.0, now=lambda: now[0])
    assert [shared(), shared()] == [1, 1]
    now[0] = 109.9
    assert shared() == 1
    now[0] = 110.0
    assert shared() == 2


def test_nothing_is_kept_where_nothing_may_be() -> None:
    shared = SharedCache(CountingMaker(), every=0.0)
    assert [shared(), shared(), shared()] == [1, 2, 3]


def test_an_error_is_kept_as_long_as_a_value() -> None:
    make, now = CountingMaker(), [100.0]
    shared = SharedCache(make, every=10.0, now=lambda: now[0])
    make.fails = True
    for _ in range(2):
        with pytest.raises(ValueError, match="1"):
            shared()
    make.fails, now[0] = False, 111.0
    assert shared() == 2


def test_many_at_once_share_one_call() -> None:
    began, go = threading.Event(), threading.Event()
    calls: list[int] = []

    def make() -> int:
        calls.append(1)
        began.set()
        assert go.wait(60)
        return len(calls)

    shared = SharedCache(make, every=600.0)
    with ThreadPoolExecutor(8) as pool:
        asked = [pool.submit(shared) for _ in range(8)]
        assert began.wait(60)
        go.set()
        assert [each.result(60) for each in asked] == [1] * 8
    assert calls == [1]


def test_who_comes_while_it_is_made_does_not_ask_again() -> None:
    """Even without caching: a caller that waited for a running call takes its value."""
    inside: list[int] = []
    shared: SharedCache[int]

    def make() -> int:
        if not inside:
            inside.append(1)
            later.start()
            waiting.wait(60)
        else:
            inside.append(2)
        return len(inside)

    got: list[int] = []
    waiting = threading.Event()
    later = threading.Thread(target=lambda: got.append(shared()))
    shared = SharedCache(make, every=0.0)
    guard = shared._guard

    class Told:
        """The lock of Shared, which reports when a caller starts to wait for it."""

        def __enter__(self) -> bool:
            if threading.current_thread() is later:
                waiting.set()
            return guard.__enter__()

        def __exit__(self, *exc: object) -> None:
            guard.release()

    shared._guard = Told()  # type: ignore[assignment]
    assert shared() == 1
    later.join(60)
    assert got == [1]
    assert inside == [1]


def test_the_past_is_read_again_only_where_it_changed(tmp_path: Path) -> None:
    hosts, now = FakeFleet.of(["edge1", "edge2"]), [NOW]

    def clock() -> float:
        now[0] += 1.0
        return now[0]

    fleet = Fleet(
        inventory=an_inventory(an_edge("edge1"), an_edge("edge2")), tasks=some_tasks(a_task("slam")), transport=hosts.transport,
        state=tmp_path, clock=clock,
    )  # fmt: skip
    with keep_sessions_open(fleet) as near:
        past = RevisionCache(near)
        assert collect_fleet_metrics(near, ProbeOptions(), past).revisions == ()
        plan_and_apply(fleet, Policy())
        first = collect_fleet_metrics(near, ProbeOptions(), past)
        assert [revision.number for revision in first.revisions] == [1]
        assert collect_fleet_metrics(near, ProbeOptions(), past).revisions is first.revisions
        plan_and_apply(
            dataclasses.replace(fleet, tasks=some_tasks(a_task("slam"), a_task("camera"))), Policy()
        )
        assert [revision.number for revision in past()] == [1, 2]
    assert first.plan.policy.attended is False
