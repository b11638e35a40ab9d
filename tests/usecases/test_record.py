# SPDX-License-Identifier: Apache-2.0
"""History records of the use cases, over simulated hosts."""

import dataclasses
import gc
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from edgectl.errors import ConnectError
from edgectl.model.event import Event, EventKind
from edgectl.state.lock import FleetLock, is_locked_elsewhere
from edgectl.state.store import Store
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.events import EventFilter, follow_events, list_events
from edgectl.usecases.plan import make_plan
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.record import record_snapshot
from edgectl.usecases.stop import stop_tasks
from tests.usecases.test_usecases import POLICY, Bench

HOLDER = """
import sys
from pathlib import Path
from edgectl.state.lock import FleetLock
with FleetLock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def list_kinds(found: tuple[Event, ...]) -> list[tuple[str, str | None]]:
    return [(event.kind.value, event.task or event.host) for event in found]


def list_told_events(bench: Bench) -> list[tuple[str, str | None]]:
    return list_kinds(list_events(bench.fleet, EventFilter()))


def test_every_probe_is_kept(bench: Bench) -> None:
    bench.hosts["edge1"].used = 1.5
    probe_fleet(bench.fleet)
    probe_fleet(bench.fleet)
    with Store.open(bench.fleet.state) as store:
        assert [point.usage["cpu"].used for point in store.host_points("edge1")] == [1.5, 1.5]
        assert len(store.host_points()) == 6


def test_an_apply_tells_what_it_planned_and_did_once(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    started = [("planned", None), ("task-started", "slam"), ("task-started", "navigation")]
    assert list_told_events(bench) == started
    probe_fleet(bench.fleet)
    plan_and_apply(bench.fleet, POLICY)
    assert list_told_events(bench) == started
    stop_tasks(bench.fleet, ["navigation"])
    probe_fleet(bench.fleet)
    assert list_told_events(bench) == [*started, ("task-stopped", "navigation")]


def test_a_move_is_a_handoff_with_its_gap(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    first = bench.hosts.placed["slam"]
    bench.hosts[first].used = 4.0
    bench.now += 600.0
    plan_and_apply(bench.fleet, POLICY)
    probe_fleet(bench.fleet)
    with Store.open(bench.fleet.state) as store:
        (handoff,) = (each for each in store.handoffs() if each.task == "slam")
    assert (handoff.previous_host, handoff.host) == (first, bench.hosts.placed["slam"])
    assert handoff.downtime_s is not None
    moved = [
        event
        for event in list_events(bench.fleet, EventFilter(tasks=("slam",)))
        if event.kind is EventKind.TASK_MOVED
    ]
    assert len(moved) == 1
    assert moved[0].message.startswith(f"from {first}, gap ")


def test_the_same_plan_again_is_told_once(bench: Bench) -> None:
    for _ in range(3):
        make_plan(bench.fleet, POLICY)
    assert list_told_events(bench) == [("planned", None)]


def test_a_plan_from_a_snapshot_is_not_kept(bench: Bench, tmp_path: Path) -> None:
    snapshot = probe_fleet(bench.fleet)
    (tmp_path / "history.db").unlink()
    make_plan(bench.fleet, POLICY, snapshot=snapshot)
    assert not (tmp_path / "history.db").exists()


def test_a_host_that_is_lost_and_back_is_told(bench: Bench) -> None:
    probe_fleet(bench.fleet)
    bench.hosts["edge2"].faults["probe"] = ConnectError("connection refused", host="edge2")
    probe_fleet(bench.fleet)
    probe_fleet(bench.fleet)
    del bench.hosts["edge2"].faults["probe"]
    probe_fleet(bench.fleet)
    assert list_kinds(list_events(bench.fleet, EventFilter(host="edge2"))) == [
        ("host-lost", "edge2"),
        ("host-back", "edge2"),
    ]


def test_trouble_with_the_history_is_said_once_and_costs_nothing_else(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "history.db").mkdir()
    applied = plan_and_apply(bench.fleet, POLICY)
    probe_fleet(bench.fleet)
    assert applied.results is not None
    assert applied.results.done
    assert len([text for text in bench.said if "history is not recorded" in text]) == 1


def test_what_another_edgectl_is_doing_is_left_to_its_own_record(bench: Bench) -> None:
    plan_and_apply(bench.fleet, POLICY)
    before = list_told_events(bench)
    place = bench.hosts.placed["slam"]
    running = bench.hosts[place].tasks.pop("slam")
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(bench.fleet.state)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    try:
        assert is_locked_elsewhere(bench.fleet.state)
        probe_fleet(bench.fleet)
        assert list_told_events(bench) == before
    finally:
        holder.communicate("", timeout=30)
    assert not is_locked_elsewhere(bench.fleet.state)
    probe_fleet(bench.fleet)
    assert list_told_events(bench) == [*before, ("task-lost", "slam")]
    bench.hosts[place].tasks["slam"] = running
    probe_fleet(bench.fleet)
    assert list_told_events(bench)[-1] == ("task-started", "slam")


def test_a_lock_that_nobody_holds_is_not_held(bench: Bench) -> None:
    assert not is_locked_elsewhere(bench.fleet.state)
    with FleetLock(bench.fleet.state):
        assert not is_locked_elsewhere(bench.fleet.state)  # it is ours
    (bench.fleet.state / "lock").write_text('{"pid": 1}')  # left by a killed manager
    assert not is_locked_elsewhere(bench.fleet.state)
    for text in ("[]", "no json", '{"pid": []}'):
        (bench.fleet.state / "lock").write_text(text)
        assert not is_locked_elsewhere(bench.fleet.state)


def test_events_are_followed_even_into_another_history(bench: Bench, tmp_path: Path) -> None:
    plan_and_apply(bench.fleet, POLICY)
    snapshot = probe_fleet(bench.fleet)

    def begin_anew() -> None:
        (tmp_path / "history.db").unlink()
        record_snapshot(bench.fleet, snapshot)
        bench.hosts["edge1"].faults["probe"] = ConnectError("connection refused", host="edge1")
        probe_fleet(bench.fleet)

    changes: list[Callable[[], object]] = [
        lambda: None,
        lambda: stop_tasks(bench.fleet, ["navigation"]),
        begin_anew,
        lambda: None,
    ]
    steps = iter(changes)

    def told_to_end() -> bool:
        step = next(steps, None)
        if step is not None:
            step()
        return step is None

    batches = [list_kinds(batch) for batch in follow_events(bench.fleet, EventFilter(), told_to_end)]
    assert batches == [
        [("planned", None), ("task-started", "slam"), ("task-started", "navigation")],
        [("task-stopped", "navigation")],
        [("host-lost", "edge1")],
    ]


def test_one_history_is_open_for_all_that_share_a_fleet_and_none_afterwards(tmp_path: Path) -> None:
    def open_files() -> list[str]:
        links = (str(path.readlink()) for path in Path("/proc/self/fd").iterdir() if path.exists())
        return [
            link
            for link in links
            if link.startswith(str(tmp_path)) and "history.db" in link and not link.endswith("-shm")
        ]

    bench = Bench(tmp_path)
    for _ in range(3):
        probe_fleet(dataclasses.replace(bench.fleet, warn=bench.said.append))
    assert len(open_files()) == 2  # the file and its log
    (tmp_path / "history.db").rename(tmp_path / "moved.db")
    probe_fleet(bench.fleet)
    with Store.open(tmp_path) as store:
        assert len(store.host_points("edge1")) == 1
    del bench
    gc.collect()
    assert open_files() == []
    assert [path.name for path in tmp_path.glob("history.db*")] == ["history.db"]
