# SPDX-License-Identifier: Apache-2.0
"""The history in SQLite: records are read back, size is bounded, and no failure is fatal."""

import contextlib
import dataclasses
import random
import sqlite3
import stat
from pathlib import Path

import pytest

from edgectl.model.event import Event, EventKind
from edgectl.model.resource import Usage
from edgectl.model.snapshot import (
    DeviceSample,
    HostStatus,
    InterfaceSample,
    LinkSample,
    Snapshot,
    TaskSample,
    TaskState,
)
from edgectl.state.store import Retention, Store
from tests.builders import NOW, a_run, a_sample, a_snapshot, silent


def a_task(**changes: object) -> TaskSample:
    """A ready task, 100 s old, using half a core."""
    ready = TaskSample(
        state=TaskState.READY,
        started_at=NOW - 100,
        used=Usage(cpu=0.5, memory=1e6),
        instance="i1",
        spec_hash="s1",
    )
    return dataclasses.replace(ready, **changes)  # type: ignore[arg-type]


def test_what_is_recorded_is_read_back(tmp_path: Path) -> None:
    link = LinkSample(capacity_bytes_per_s=1e7, used_bytes_per_s=2e5, rtt_ms=1.5)
    with Store.open(tmp_path) as store:
        for second in range(3):
            edge1 = a_sample(used=float(second), links={"robot1": link}, tasks={"slam": a_task()})
            store.record_snapshot(a_snapshot(taken_at=NOW + second, edge1=edge1, edge2=silent()))
    with Store.open(tmp_path) as store:
        assert [point.usage["cpu"].used for point in store.host_points("edge1")] == [0.0, 1.0, 2.0]
        assert [point.usage["cpu"].used for point in store.host_points("edge1", limit=2)] == [1.0, 2.0]
        assert [point.usage["cpu"].used for point in store.host_points("edge1", since=NOW + 2)] == [2.0]
        assert {point.status for point in store.host_points("edge2")} == {HostStatus.UNREACHABLE}
        assert len(store.host_points(limit=1)) == 2
        assert [(point.edge, point.robot, point.rtt_ms) for point in store.link_points(limit=1)] == [
            ("edge1", "robot1", 1.5)
        ]
        assert [
            (point.task, point.host, point.age_s, point.spec_hash)
            for point in store.task_points("slam", limit=1)
        ] == [("slam", "edge1", 102.0, "s1")]


def test_throughput_that_is_partly_seen_is_no_figure_of_a_demand(tmp_path: Path) -> None:
    used = Usage(cpu=0.5, network=2e4)
    with Store.open(tmp_path) as store:
        for second, partial in enumerate(("udp unseen", "")):
            tasks = {"slam": a_task(used=used, partial=partial)}
            store.record_snapshot(a_snapshot(taken_at=NOW + second, edge1=a_sample(tasks=tasks)))
        points = store.task_points("slam")
    assert [(each.used["cpu"], each.used["network"]) for each in points] == [(0.5, 0.0), (0.5, 2e4)]


def test_a_file_without_the_columns_of_a_resource_gets_them(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.record_snapshot(a_snapshot(taken_at=NOW, edge1=a_sample(used=1.0, tasks={"slam": a_task()})))
    with contextlib.closing(sqlite3.connect(tmp_path / "history.db")) as older:
        older.executescript(
            "ALTER TABLE host_samples DROP COLUMN used_bytes; ALTER TABLE host_samples DROP COLUMN total_bytes;"
            "DROP VIEW task_samples; ALTER TABLE uses DROP COLUMN used_bytes;"
            "CREATE VIEW task_samples AS SELECT at, task FROM starts JOIN uses USING (start);"
            "ALTER TABLE known_hosts DROP COLUMN access_points"
        )
    used = Usage(cpu=0.5, memory=2e8)
    with Store.open(tmp_path, warn=pytest.fail) as store:
        store.record_snapshot(
            a_snapshot(taken_at=NOW + 1, edge1=a_sample(used_memory=3e8, tasks={"slam": a_run(used=used)}))
        )
        assert [point.amounts["used_bytes"] for point in store.host_points("edge1")] == [None, 3e8]
        assert [point.used["memory"] for point in store.task_points("slam")] == [0.0, 2e8]


def test_roaming_is_recorded_by_another_call_than_the_one_that_saw_the_first_access_point(
    tmp_path: Path,
) -> None:
    for second, point in enumerate(("02:00:00:00:00:0a", "02:00:00:00:00:0b", "02:00:00:00:00:0b")):
        radio = InterfaceSample(rx_bytes_per_s=0.0, tx_bytes_per_s=0.0, access_point=point)
        robot = dataclasses.replace(a_sample(), device=DeviceSample(interfaces={"wlan0": radio}))
        with Store.open(tmp_path, warn=pytest.fail) as store:
            store.record_snapshot(a_snapshot(taken_at=NOW + second, robot1=robot))
    with Store.open(tmp_path) as store:
        [event] = store.events()
    assert (event.kind, event.host, event.at) == (EventKind.ROAMED, "robot1", NOW + 1)
    assert event.message == "wlan0 joined 02:00:00:00:00:0b, after 02:00:00:00:00:0a"


def test_the_same_snapshot_again_changes_nothing(tmp_path: Path) -> None:
    snapshot = a_snapshot(edge1=a_sample(tasks={"slam": a_task()}), edge2=silent())
    with Store.open(tmp_path) as store:
        store.record_snapshot(snapshot)
        before = store.host_points(), store.task_points(), store.events()
        store.record_snapshot(snapshot)
        assert (store.host_points(), store.task_points(), store.events()) == before
        assert [event.kind for event in store.events()] == [EventKind.HOST_LOST]


def draw_snapshot(draw: random.Random, at: float) -> Snapshot:
    """Hosts, links and tasks that come, go, and change."""
    hosts = {}
    for name in draw.sample(["edge3", "edge1", "edge2"], draw.randint(1, 3)):
        links = {
            robot: LinkSample(capacity_bytes_per_s=1e7, used_bytes_per_s=draw.random(), rtt_ms=None)
            for robot in draw.sample(["robot2", "robot1"], draw.randint(0, 2))
        }
        tasks = {
            task: a_task(instance=draw.choice(["i1", "i2"]))
            for task in draw.sample(["slam", "nav"], draw.randint(0, 2))
        }
        nic = InterfaceSample(
            rx_bytes_per_s=1.0, tx_bytes_per_s=2.0, access_point=draw.choice(["", "a", "b"])
        )
        device = DeviceSample(boot_id=draw.choice(["b1", "b2"]), interfaces={"wlan0": nic})
        sample = a_sample(used=draw.random(), links=links, tasks=tasks)
        sample = dataclasses.replace(sample, device=device)
        hosts[name] = draw.choice([sample, sample, silent()])
    return dataclasses.replace(a_snapshot(taken_at=at), hosts=hosts)


def dump_rows(folder: Path) -> dict[str, list[tuple[object, ...]]]:
    with contextlib.closing(sqlite3.connect(folder / "history.db")) as connection:
        names = [
            name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        ]
        return {name: list(connection.execute(f"SELECT * FROM {name}")) for name in sorted(names)}


@pytest.mark.parametrize("seed", range(8))
def test_what_a_store_remembers_is_what_it_would_read(seed: int, tmp_path: Path) -> None:
    """Also where another process writes, removes what is old, or the file is replaced in between."""
    draw, at = random.Random(seed), NOW
    short = Retention(samples_s=20.0, records_s=30.0)
    folders = [tmp_path / "kept", tmp_path / "anew"]
    for folder in folders:
        folder.mkdir()
    with Store.open(folders[0], retention=short) as kept:
        for _ in range(30):
            at += draw.choice([0.0, 1.0, 1.0, 40.0])
            snapshot = draw_snapshot(draw, at)
            other = draw_snapshot(draw, at + 0.5) if draw.random() < 0.2 else None
            act = draw.choice(["", "", "", "prune", "replace"])
            for folder in folders:
                if act == "replace":
                    for path in folder.glob("history.db*"):
                        path.unlink()
                with Store.open(folder, retention=short) as fresh:
                    (kept if folder is folders[0] else fresh).record_snapshot(snapshot)
                    if other is not None:
                        fresh.record_snapshot(other)
                    if act == "prune":
                        (fresh if folder is folders[1] or draw.random() < 0.5 else kept).prune(at)
            assert dump_rows(folders[0]) == dump_rows(folders[1])


def test_a_store_reads_nothing_again_that_it_has_written(tmp_path: Path) -> None:
    link = LinkSample(capacity_bytes_per_s=1e7, used_bytes_per_s=0.0)
    asked: list[str] = []
    with Store.open(tmp_path) as store:
        for second in range(3):
            store._file.use().set_trace_callback(asked.append)
            del asked[:]
            edge = a_sample(links={"robot2": link, "robot1": link}, tasks={"slam": a_task()})
            store.record_snapshot(a_snapshot(taken_at=NOW + second, edge2=edge, edge1=edge))
            reads = [each for each in asked if each.startswith("SELECT")]
            # How many snapshots wait to be moved; others write, too.
            assert reads.pop() == "SELECT count(*) FROM new_instants"
            assert len(reads) == (4 if second == 0 else 0), reads


def test_the_files_are_private(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        store.record_snapshot(a_snapshot(edge1=a_sample()))
        modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    assert modes == {"history.db": 0o600, "history.db-wal": 0o600, "history.db-shm": 0o600}


def test_events_are_found_by_place_and_time(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        for number in range(5):
            store.record_events(
                [
                    Event(
                        at=NOW + number,
                        kind=EventKind.HOST_LOST,
                        host=f"edge{number % 2}",
                        message=str(number),
                    )
                ]
            )
        assert [event.message for event in store.events()] == ["0", "1", "2", "3", "4"]
        assert [event.message for event in store.events(host="edge1")] == ["1", "3"]
        assert [event.message for event in store.events(since=NOW + 3)] == ["3", "4"]
        assert [event.message for event in store.events(limit=1)] == ["4"]
        last = store.events()[-1].id
        assert store.events(after=last) == ()
        store.record_events([Event(at=NOW, kind=EventKind.TASK_LOST, task="slam")])
        assert [event.task for event in store.events(after=last)] == ["slam"]


def test_old_rows_go(tmp_path: Path) -> None:
    with Store.open(tmp_path, retention=Retention(samples_s=10, records_s=100)) as store:
        store.record_snapshot(a_snapshot(taken_at=NOW, edge1=silent()))
        store.record_snapshot(a_snapshot(taken_at=NOW + 50, edge1=a_sample()))
        assert not store.is_prune_due(NOW)
        assert store.is_prune_due(NOW + 3600)
        store.prune(NOW + 61)
        assert store.host_points() == ()
        assert len(store.events()) == 2
        assert not store.is_prune_due(NOW + 61)
        store.prune(NOW + 120)
        assert [event.kind for event in store.events()] == [EventKind.HOST_BACK]


def test_a_broken_file_is_set_aside_and_said(tmp_path: Path) -> None:
    (tmp_path / "history.db").write_bytes(b"not a database, but long enough to look at" * 100)
    said: list[str] = []
    with Store.open(tmp_path, warn=said.append) as store:
        store.record_snapshot(a_snapshot(edge1=a_sample()))
        assert len(store.host_points()) == 1
    assert (tmp_path / "history.db.broken-1").exists()
    assert len(said) == 1
    assert "set aside as history.db.broken-1" in said[0]
