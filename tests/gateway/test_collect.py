# SPDX-License-Identifier: Apache-2.0
"""Probing all hosts in parallel; a failing host affects only itself."""

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from edgectl.errors import (
    AuthError,
    ConnectError,
    DeadlineError,
    HostError,
    HostKeyError,
    NoPythonError,
    RefusedError,
    ReplyError,
)
from edgectl.gateway import readings
from edgectl.gateway.fanout import fan_out
from edgectl.gateway.host_probe import DecodedProbe, ProbeOptions, probe_hosts
from edgectl.gateway.readings import FleetReadings
from edgectl.model.check import Check, CheckLocation
from edgectl.model.inventory import Host, Inventory
from edgectl.model.snapshot import HostSample, HostStatus, TaskState
from edgectl.model.task import DetectRule, Tasks
from edgectl.transport.base import Reply, Session
from edgectl.transport.fake import FakeTransport
from edgectl.transport.readings import ReadingFeeds
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet
from tests.pace import patience

NONE = Tasks(tasks={})


def build_inventory() -> Inventory:
    return an_inventory(
        an_edge("edge1"),
        an_edge("edge2"),
        an_edge("edge10"),
        a_robot("robot1"),
        a_robot("robot2", probe=False),
    )


def test_hosts_stand_in_the_order_of_the_inventory_and_unprobed_robots_are_left_out() -> None:
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    snapshot = probe_hosts(build_inventory(), NONE, hosts.transport, clock=lambda: NOW)
    assert list(snapshot.hosts) == ["edge1", "edge2", "edge10", "robot1"]
    assert snapshot.taken_at == NOW
    assert all(sample.ok for sample in snapshot.hosts.values())
    assert list(snapshot.hosts["edge1"].links) == ["robot1", "robot2"]
    assert snapshot.hosts["robot1"].links == {}


def test_names_are_resolved_once_for_the_cycles_of_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes a thread, as any of them may take its time."""
    asked: list[str] = []

    class Resolving(FakeTransport):
        def address(self, host: Host) -> str:
            asked.append(host.name)
            return f"{host.name}.lab"

    transport = Resolving(dict.fromkeys(["edge1", "edge2", "edge10", "robot1"], ConnectError("is off")))
    kept = FleetReadings[DecodedProbe](ReadingFeeds(), every=1.0)
    for options in (ProbeOptions(), ProbeOptions(), *[ProbeOptions(readings=kept)] * 3):
        probe_hosts(build_inventory(), NONE, transport, options=options)
    assert sorted(asked) == sorted(["edge1", "edge2", "edge10", "robot1", "robot2"] * 3)
    monkeypatch.setattr(readings, "_RESOLVE_EACH_S", 0.0)
    probe_hosts(build_inventory(), NONE, transport, options=ProbeOptions(readings=kept))
    assert len(asked) == 4 * 5


@pytest.mark.parametrize(
    "error",
    [
        ConnectError("no route to host", hint="is it on?"),
        HostKeyError("host key changed", hint="edgectl trust edge1"),
        AuthError("no key was accepted"),
        DeadlineError("no answer within 15 s"),
        NoPythonError("no python3"),
        ReplyError("no frame"),
    ],
    ids=lambda error: error.kind,
)
def test_a_bad_host_is_unreachable_with_its_cause_and_costs_no_other(error: HostError) -> None:
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    transport = FakeTransport({**dict(hosts.hosts), "edge2": error})
    snapshot = probe_hosts(build_inventory(), NONE, transport)
    bad = snapshot.hosts["edge2"]
    assert (bad.status, bad.error, bad.error_kind, bad.hint) == (
        HostStatus.UNREACHABLE,
        error.message,
        error.kind,
        error.hint,
    )
    assert [name for name, sample in snapshot.hosts.items() if sample.ok] == ["edge1", "edge10", "robot1"]


def test_a_host_that_lies_is_unreachable() -> None:
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    liar = {**hosts["edge1"](_request("edge1")), "host": "edge2", "cpu": {"cores": 64, "used_cores": 0}}
    snapshot = probe_hosts(
        build_inventory(), NONE, FakeTransport({**dict(hosts.hosts), "edge1": lambda _request: liar})
    )
    assert snapshot.hosts["edge1"].error_kind == "bad-reply"
    assert snapshot.hosts["edge2"].ok


def _request(host: str) -> dict[str, object]:
    return {"op": "probe", "host": host, "links": []}


def test_hosts_are_asked_at_once_and_each_is_told_as_it_ends() -> None:
    hosts = FakeFleet.of([f"edge{number}" for number in range(16)])

    together = threading.Barrier(16)

    def slow(name: str) -> Callable[[dict[str, object]], dict[str, object]]:
        def answer(request: dict[str, object]) -> dict[str, object]:
            together.wait(30)
            time.sleep(0.3)
            return hosts[name](request)

        return answer

    heard: list[tuple[str, bool, bool]] = []

    def on_host(name: str, sample: HostSample, seconds: float) -> None:
        heard.append((name, sample.ok, seconds >= 0.3))
        assert threading.current_thread() is threading.main_thread()

    inventory = an_inventory(*(an_edge(name) for name in hosts.hosts))
    probe_hosts(
        inventory,
        NONE,
        FakeTransport({name: slow(name) for name in hosts.hosts}),
        options=ProbeOptions(on_host=on_host),
    )
    assert sorted(heard) == sorted((name, True, True) for name in hosts.hosts)


class SlowTransport:
    """A transport whose dead hosts reply only after ``together`` of all are waiting, and whose live hosts are
    slow.

    It records the timeout of each call.
    """

    def __init__(self, fleet: FakeFleet, dead: set[str], *, together: int, connect_s: float = 0.0) -> None:
        self.fleet, self.dead, self.connect_s = fleet, dead, connect_s
        self.together = threading.Barrier(together)
        self.given: list[float] = []
        self.at_once, self.most, self.guard = 0, 0, threading.Lock()

    def connect(self, host: Host, *, timeout: float) -> Session:
        with self.guard:
            self.at_once += 1
            self.most = max(self.most, self.at_once)
        if host.name in self.dead or not self.dead:
            self.together.wait(30)
        time.sleep(self.connect_s)
        with self.guard:
            self.at_once -= 1
        if host.name in self.dead:
            raise DeadlineError(f"no answer within {timeout:g} s")
        session = self.fleet.transport.connect(host, timeout=timeout)
        run = session.run

        def noting(command: str, stdin: bytes, *, timeout: float, limit: int = 1 << 20) -> Reply:
            self.given.append(timeout)
            return run(command, stdin, timeout=timeout, limit=limit)

        session.run = noting  # type: ignore[method-assign]
        return session

    def address(self, host: Host) -> str:
        return host.host


def build_fleet(count: int) -> tuple[Inventory, FakeFleet]:
    hosts = FakeFleet.of([f"edge{number}" for number in range(count)])
    return an_inventory(*(an_edge(name) for name in hosts.hosts)), hosts


def test_ten_dead_hosts_of_fifty_are_waited_for_together() -> None:
    inventory, hosts = build_fleet(50)
    dead = {f"edge{number}" for number in range(0, 50, 5)}
    snapshot = probe_hosts(inventory, NONE, SlowTransport(hosts, dead, together=10))
    assert {name for name, sample in snapshot.hosts.items() if not sample.ok} == dead
    assert {snapshot.hosts[name].error_kind for name in dead} == {"deadline"}


def test_connecting_and_calling_share_one_deadline_and_connections_are_bounded() -> None:
    inventory, hosts = build_fleet(12)
    transport = SlowTransport(hosts, set(), together=4, connect_s=0.2)
    probe_hosts(inventory, NONE, transport, options=ProbeOptions(timeout=20.0, workers=4))
    assert transport.most == 4
    assert len(transport.given) == 12
    assert max(transport.given) <= 19.8


def test_what_is_asked_depends_on_the_host() -> None:
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    tasks = some_tasks(
        a_task("slam", robots=["robot1"], done_when=Check(command="map is whole", timeout=60.0)),
        a_task("mission", robots=["robot1"], done_when=Check(command="is home", on=CheckLocation.ROBOT)),
        a_task("roscore", managed=False, detect=DetectRule(cmdline="rosmaster")),
    )
    transport = hosts.transport
    probe_hosts(build_inventory(), tasks, transport, options=ProbeOptions(window=0.2))
    asked = dict(transport.requests)
    assert asked["edge1"]["window_s"] == 0.2
    assert asked["edge1"]["links"] == [
        {"robot": "robot1", "address": "robot1.lab"},
        {"robot": "robot2", "address": "robot2.lab"},
    ]
    assert asked["edge1"]["detect"] == [{"task": "roscore", "cmdline": "rosmaster"}]
    checks: Any = asked["edge1"]["checks"]
    (check,) = checks
    assert (check["task"], check["always"], check["timeout_s"]) == (
        "slam",
        False,
        10.8,
    )  # 15 - .2 - 4: it must not fail the probe
    assert check["env"]["EDGECTL_ROBOT"] == "robot1"
    of_robot: Any = asked["robot1"]["checks"]
    names = {entry["task"]: entry["always"] for entry in of_robot}
    assert names == {"slam": False, "mission": True}
    assert asked["robot1"]["links"] == []


def test_what_a_robot_says_is_done_is_done_where_it_runs() -> None:
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    hosts["edge2"].runs("mission")
    hosts["edge2"].used = 1.0
    said = {
        **hosts["robot1"](_request("robot1")),
        "checks": {"mission": {"exit": 0, "timed_out": False, "output": ""}},
    }
    tasks = some_tasks(
        a_task("mission", robots=["robot1"], done_when=Check(command="is home", on=CheckLocation.ROBOT))
    )
    snapshot = probe_hosts(
        build_inventory(), tasks, FakeTransport({**dict(hosts.hosts), "robot1": lambda _request: said})
    )
    sample = snapshot.hosts["edge2"]
    assert (sample.tasks["mission"].state, sample.tasks["mission"].pid) == (TaskState.COMPLETED, 99)
    assert sample.measured
    assert sample.usage["cpu"].used == pytest.approx(0.9)


def test_a_bug_is_not_swallowed() -> None:
    def broken(_item: int) -> int:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        list(fan_out(broken, [1, 2, 3], workers=2))


def test_what_is_done_meanwhile_is_done_while_the_calls_run() -> None:
    done = threading.Event()
    answers = dict(fan_out(lambda _: done.wait(patience(30)), ["b", "a", "c"], workers=3, meanwhile=done.set))
    assert answers == {0: True, 1: True, 2: True}


def test_fan_out_of_nothing_is_nothing() -> None:
    assert list(fan_out(str, [], workers=4)) == []


def other_task(fleet: str, host: str, task: str, **fields: object) -> dict[str, object]:
    return {
        "fleet": fleet,
        "host": host,
        "task": task,
        "state": "running",
        "instance": f"{host}-{task}",
    } | fields


def test_other_tasks_of_a_machine_are_split_by_fleet_and_told_once() -> None:
    """A task that the host of its name reports itself is no other one, as on a machine with two names."""
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    hosts["edge2"].runs("slam", instance="edge2-slam")
    hosts["edge1"].others = [
        other_task("unnamed", "edge2", "slam"),
        other_task("hall", "edge2", "slam", started_by="eve\x1b[2J@x", age_s=60),
    ]
    sample = probe_hosts(build_inventory(), NONE, hosts.transport).hosts["edge1"]
    assert sample.other_tasks == ()
    (foreign,) = sample.foreign_tasks
    assert (foreign.fleet, foreign.started_by, foreign.age_s) == ("hall", "eve\\x1b[2J@x", 60.0)


def test_known_tasks_without_an_owner_are_adopted_and_probed_again() -> None:
    """Those of the first release: the fleet takes what it names, and nothing else."""
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    adopted: list[object] = []

    def edge1(request: dict[str, object]) -> dict[str, object]:
        if request["op"] == "adopt":
            adopted.append(request["tasks"])
            hosts["edge1"].runs("slam")
            return {"adopted": request["tasks"]}
        return hosts["edge1"](request) | {"unowned": ["web"] if adopted else ["slam", "web"]}

    transport = FakeTransport({**dict(hosts.hosts), "edge1": edge1})
    options = ProbeOptions(known_tasks=lambda: frozenset({"slam", "nav"}))
    snapshot = probe_hosts(build_inventory(), NONE, transport, options=options)
    assert (adopted, list(snapshot.hosts["edge1"].tasks)) == ([["slam"]], ["slam"])
    adopted_before = list(adopted)
    probe_hosts(build_inventory(), NONE, transport, options=options)
    assert adopted == adopted_before


def test_a_former_name_is_adopted_by_one_host_of_its_machine_and_given_back() -> None:
    """Two names of one machine list its task; counted twice, one of the two would be stopped as a duplicate."""
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    for name in ("edge1", "edge2"):
        hosts[name].others = [other_task("unnamed", "old", "slam"), other_task("unnamed", "older", "nav")]
    snapshot = probe_hosts(build_inventory(), NONE, hosts.transport)
    assert {name: sorted(host.tasks) for name, host in snapshot.hosts.items()} == {
        "edge1": ["nav", "slam"],
        "edge2": [],
        "edge10": [],
        "robot1": [],
    }
    assert snapshot.hosts["edge2"].other_tasks == ()
    assert (hosts["edge1"].former, hosts["edge2"].former) == (["old", "older"], [])
    hosts["edge10"].former = ["edge1", "gone"]
    probe_hosts(build_inventory(), NONE, hosts.transport)
    assert hosts["edge10"].former == ["gone"]


def test_a_host_that_cannot_adopt_a_name_holds_what_runs_there() -> None:
    hosts = FakeFleet.of(["edge1", "edge2", "edge10", "robot1"])
    hosts["edge1"].others = [other_task("unnamed", "old", "slam")]
    hosts["edge1"].faults["adopt"] = RefusedError("no place to keep the former names of the host")
    snapshot = probe_hosts(build_inventory(), NONE, hosts.transport)
    assert snapshot.silent_hosts == ("edge1",)
    assert snapshot.hosts["edge1"].error == "no place to keep the former names of the host"
