# SPDX-License-Identifier: Apache-2.0
"""Repeated status queries: one session per host, hosts that come and go, and a history that grows with each
query.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from edgectl.model.event import EventKind
from edgectl.model.inventory import Host
from edgectl.model.task import Task
from edgectl.transport.base import Session, Transport
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.status import load_host_points, load_last_events, load_task_points, probe_repeatedly
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet


class CountingTransport:
    """Counts connections."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self.opened: list[str] = []

    def connect(self, host: Host, *, timeout: float) -> Session:
        self.opened.append(host.name)
        return self._transport.connect(host, timeout=timeout)

    def address(self, host: Host) -> str:
        return self._transport.address(host)


class Bench:
    """Two edges and a robot; slam runs on edge1. Each query is a second after the previous one."""

    def __init__(self, state: Path, *tasks: Task) -> None:
        self.hosts = FakeFleet.of(["edge1", "edge2", "robot1"])
        self.hosts["edge1"].runs("slam")
        self.transport = CountingTransport(self.hosts.transport)
        self.now = NOW
        self.fleet = Fleet(
            inventory=an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1")), tasks=some_tasks(*tasks),
            transport=self.transport, state=state, clock=lambda: self.now,
        )  # fmt: skip

    def looks(self, count: int, before: Callable[[int], None] = lambda number: None) -> list[dict[str, bool]]:
        """Return the hosts that answered each of ``count`` queries; ``before`` is called between two."""
        left = iter(range(1, count))

        def told() -> bool:
            number = next(left, None)
            if number is None:
                return True
            self.now += 1.0
            before(number)
            return False

        return [
            {name: host.ok for name, host in snapshot.hosts.items()}
            for snapshot in probe_repeatedly(self.fleet, told)
        ]


def test_sessions_stay_open_and_every_look_is_remembered(tmp_path: Path) -> None:
    bench = Bench(tmp_path, a_task("slam"))
    assert bench.looks(4) == [{"edge1": True, "edge2": True, "robot1": True}] * 4
    assert sorted(bench.transport.opened) == ["edge1", "edge2", "robot1"]
    assert [point.at - NOW for point in load_host_points(bench.fleet, 3) if point.host == "edge1"] == [
        1.0,
        2.0,
        3.0,
    ]
    assert [point.at - NOW for point in load_task_points(bench.fleet, 60)] == [0.0, 1.0, 2.0, 3.0]


def test_a_host_that_goes_away_and_comes_back_is_told(tmp_path: Path) -> None:
    bench = Bench(tmp_path, a_task("slam"))
    steps = {2: lambda: bench.hosts.down.add("edge2"), 3: bench.hosts.down.clear}
    seen = bench.looks(4, lambda number: steps.get(number, lambda: None)())
    assert [look["edge2"] for look in seen] == [True, True, False, True]
    assert all(look["edge1"] for look in seen)
    assert [event.kind for event in load_last_events(bench.fleet, 10, host="edge2")] == [
        EventKind.HOST_LOST,
        EventKind.HOST_BACK,
    ]
    assert ["cpu" in point.usage for point in load_host_points(bench.fleet, 60) if point.host == "edge2"] == [
        True,
        True,
        False,
        True,
    ]


def test_there_is_nothing_to_look_back_on_at_first(tmp_path: Path) -> None:
    fleet = dataclasses.replace(Bench(tmp_path).fleet, state=tmp_path / "new")
    (tmp_path / "new").mkdir(mode=0o700)
    assert (
        load_host_points(fleet, 60),
        load_task_points(fleet, 60),
        load_last_events(fleet, 10, host="edge1"),
    ) == ((), (), ())
