# SPDX-License-Identifier: Apache-2.0
"""Heartbeats under a watch: a host that hangs does not keep them from the others."""

import threading
import time
from pathlib import Path

import pytest

from edgectl.errors import DeadlineError
from edgectl.usecases.heartbeat import compute_heartbeat_pause_s, send_heartbeats
from tests.builders import a_task, some_tasks
from tests.executor.fake_fleet import Request
from tests.usecases.watch_site import WatchSite

FENCE_S = 0.4


@pytest.fixture
def site(tmp_path: Path) -> WatchSite:
    return WatchSite(tmp_path, tasks=some_tasks(a_task("slam", cpu=1.0, self_fence=FENCE_S)))


def test_a_hanging_host_keeps_no_heartbeat_from_another(site: WatchSite) -> None:
    beats, over = list[float](), threading.Event()

    def hang(_request: Request) -> Request:
        over.wait(5.0)
        raise DeadlineError("no answer")

    def beat(_request: Request) -> Request:
        beats.append(time.monotonic())
        return {"tasks": {}}

    site.hosts["edge1"].faults["status"] = hang
    site.hosts["edge2"].faults["status"] = beat
    assert compute_heartbeat_pause_s(site.fleet) == FENCE_S / 4
    with send_heartbeats(site.fleet, lambda: ("edge1", "edge2")):
        deadline = time.monotonic() + 10.0
        while len(beats) < 5 and time.monotonic() < deadline:
            time.sleep(0.01)
        over.set()
    assert len(beats) >= 5, "edge1 hangs in its first heartbeat all the time"


def test_heartbeats_go_on_while_the_sample_of_a_cycle_waits_for_a_host(site: WatchSite) -> None:
    beats, sampling = list[float](), threading.Event()

    def beat(_request: Request) -> Request:
        if sampling.is_set():
            beats.append(time.monotonic())
        return {"tasks": {}}

    def hang(request: Request) -> Request:
        sampling.set()
        deadline = time.monotonic() + 10.0
        while len(beats) < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
        return site.hosts["edge1"]._probe(request)

    site.hosts["edge2"].faults["status"] = beat

    def freeze() -> None:
        site.hosts["edge1"].faults["probe"] = hang

    cycles = list(site.watch(2, {1: freeze}, apply=False))
    assert [cycle.error for cycle in cycles] == ["", ""]
    assert len(beats) >= 3
