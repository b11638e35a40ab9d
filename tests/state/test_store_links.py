# SPDX-License-Identifier: Apache-2.0
"""Samples of links in the history: where they are gathered and moved, and what a snapshot writes."""

import random
import sqlite3
from contextlib import nullcontext
from pathlib import Path

import pytest

from edgectl.model.snapshot import LinkSample, Snapshot
from edgectl.state.store import Retention, Store
from edgectl.state.store_file import HISTORY_FILE_NAME, open_database
from edgectl.state.store_write import write_samples
from tests.builders import NOW, a_sample, a_snapshot

# As many snapshots as are moved together, twice, and some more.
SNAPSHOTS = 130


def record(store: Store, second: int, *robots: str) -> None:
    """Record a snapshot in which ``second`` is a hundredth of the capacity of each link."""
    links = {
        robot: LinkSample(capacity_bytes_per_s=100.0, used_bytes_per_s=float(second), rtt_ms=1.5)
        for robot in robots
    }
    store.record_snapshot(a_snapshot(taken_at=NOW + second, edge1=a_sample(links=links)))


def count_rows(directory: Path, table: str) -> int:
    connection = sqlite3.connect(directory / HISTORY_FILE_NAME)
    try:
        return int(connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0])
    finally:
        connection.close()


def test_samples_are_read_alike_before_and_after_they_were_moved(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        for second in range(SNAPSHOTS):
            record(store, second, "robot2", "robot1")
            seconds = [point.at - NOW for point in store.link_points("edge1", "robot1")]
            assert seconds == list(range(second + 1))
        both = store.link_points()
        assert [(point.at - NOW, point.robot) for point in both[-4:]] == [
            (second, robot) for second in (128, 129) for robot in ("robot2", "robot1")
        ]
        assert [point.at - NOW for point in store.link_points(robot="robot2", limit=45)] == list(
            range(85, 130)
        )
        assert [point.at - NOW for point in store.link_points(robot="robot2", since=NOW + 118)] == list(
            range(118, 130)
        )
        shares = [shares for name, shares in store.used_shares("edge1", limit=20) if name == "network"]
        assert shares == [tuple(second / 100 for second in range(110, 130))] * 2
    moved, new = count_rows(tmp_path, "loads"), count_rows(tmp_path, "new_loads")
    assert moved > new > 0
    assert moved + new == count_rows(tmp_path, "link_samples") == 2 * SNAPSHOTS


def test_links_that_are_gone_stay_in_the_history_and_expire(tmp_path: Path) -> None:
    with Store.open(tmp_path, retention=Retention(samples_s=1000.0)) as store:
        record(store, 0, "robot1")
        for second in range(1, 70):
            record(store, second, "robot2")
        assert [point.at - NOW for point in store.link_points(robot="robot1")] == [0]
        store.prune(NOW + 1065)
        assert store.link_points(robot="robot1") == ()
        assert [point.at - NOW for point in store.link_points()] == [65, 66, 67, 68, 69]
        assert count_rows(tmp_path, "new_instants") == count_rows(tmp_path, "new_loads") == 5
        store.prune(NOW + 1100)
    tables = ("loads", "new_loads", "new_instants", "links")
    assert [count_rows(tmp_path, table) for table in tables] == [0, 0, 0, 0]


@pytest.mark.parametrize("period", [1, 2, 3, 59, 61, 1000])
def test_samples_are_moved_whichever_hosts_come_and_go(tmp_path: Path, period: int) -> None:
    """The first edge is there in every ``period``-th snapshot, or not any more, and another one is always new."""
    most, links = 0, {"robot1": LinkSample(capacity_bytes_per_s=100.0, used_bytes_per_s=1.0)}
    with Store.open(tmp_path) as store:
        for second in range(150):
            names = ["edge2", "edge3"] if second % period else ["edge1", "edge2", "edge3"]
            if period == 1:
                names.append(f"edge{second + 4}")
            hosts = {name: a_sample(links=links) for name in names}
            store.record_snapshot(Snapshot(taken_at=NOW + second, hosts=hosts))
            most = max(most, count_rows(tmp_path, "new_loads"))
        assert len(store.link_points("edge2")) == 150
    # Each snapshot has two to four samples; the sixtieth moves them.
    assert 2 * 59 <= most <= 4 * 59


@pytest.mark.parametrize("seed", range(4))
def test_what_is_the_very_same_is_recorded_like_what_is_equal(tmp_path: Path, seed: int) -> None:
    """A watch has the links of an edge that says nothing new as the same object. One store keeps its file open, and
    sometimes another one writes beside it; the other store is opened anew for each snapshot, so it knows nothing.
    """
    draw = random.Random(seed)
    edges: dict[str, dict[str, LinkSample]] = {}
    for name in ("kept", "anew"):
        (tmp_path / name).mkdir()
    with Store.open(tmp_path / "kept") as kept:
        for second in range(200):
            for edge in draw.sample(
                [f"edge{number}" for number in range(9)], draw.choice([0, 0, 1, 1, 2, 9])
            ):
                robots = draw.sample(["robot1", "robot2", "robot3"], draw.choice([3, 3, 3, 2, 0]))
                edges[edge] = {
                    robot: LinkSample(capacity_bytes_per_s=100.0, used_bytes_per_s=draw.random())
                    for robot in robots
                }
            hosts = {name: a_sample(links=links) for name, links in edges.items() if draw.random() < 0.995}
            snapshot = Snapshot(taken_at=NOW + second - draw.choice([0, 0, 0, 0, 3]), hosts=hosts)
            with Store.open(tmp_path / "kept") if draw.random() < 0.05 else nullcontext(kept) as store:
                store.record_snapshot(snapshot)
            with Store.open(tmp_path / "anew") as store:
                store.record_snapshot(snapshot)
                if second % 20 == 0 or second > 195:
                    assert kept.link_points() == store.link_points()
        assert len({point.at for point in kept.link_points()}) > 120


def test_another_one_may_have_moved_what_would_be_repeated(tmp_path: Path) -> None:
    links = {"robot1": LinkSample(capacity_bytes_per_s=100.0, used_bytes_per_s=1.0)}
    with Store.open(tmp_path) as kept:
        for second in range(130):
            with Store.open(tmp_path) if second in (59, 119) else nullcontext(kept) as store:
                store.record_snapshot(a_snapshot(taken_at=NOW + second, edge1=a_sample(links=links)))
            if second in (59, 119):
                assert count_rows(tmp_path, "new_loads") == 0
        assert [point.at - NOW for point in kept.link_points()] == list(range(130))


def test_a_snapshot_does_not_write_a_page_for_each_link(tmp_path: Path) -> None:
    """After minutes of a watch each link has pages of its own among the samples that were moved."""
    connection = open_database(tmp_path / HISTORY_FILE_NAME)
    # What is written stays in the log, where its pages can be counted.
    connection.execute("PRAGMA wal_autocheckpoint = 0")
    numbers: dict[tuple[str, str], int] = {}
    robots = [f"robot{number}" for number in range(300)]
    written = []
    for second in range(300):
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        links = {
            robot: LinkSample(capacity_bytes_per_s=1e7, used_bytes_per_s=float(second)) for robot in robots
        }
        connection.execute("BEGIN IMMEDIATE")
        write_samples(connection, a_snapshot(taken_at=NOW + second, edge1=a_sample(links=links)), numbers)
        connection.execute("COMMIT")
        written.append(connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()[1])
    connection.close()
    assert sum(written[-120:]) / 120 < len(robots) / 10


def test_who_reads_one_link_reads_no_other_one(tmp_path: Path) -> None:
    connection = open_database(tmp_path / HISTORY_FILE_NAME)
    try:
        for view, order in (("link_samples", "DESC"), ("link_samples", "ASC"), ("all_loads", "DESC")):
            sql = f"SELECT * FROM {view} WHERE link = 7 AND at >= 5.0 ORDER BY at {order} LIMIT 9"
            steps = [str(row[3]) for row in connection.execute(f"EXPLAIN QUERY PLAN {sql}")]
            looks = [step for step in steps if step.split()[0] in ("SEARCH", "SCAN")]
            assert [step for step in looks if step.split()[1] == "loads"] == [
                "SEARCH loads USING PRIMARY KEY (link=? AND at>?)"
            ]
            assert [step for step in looks if step.split()[1] == "new_loads"] == [
                "SEARCH new_loads USING PRIMARY KEY (at=? AND link=?)"
            ]
            assert len([step for step in looks if "new_instants" in step]) == 1
    finally:
        connection.close()


def test_what_waits_in_a_history_of_schema_3_is_kept(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        for second in range(70):
            record(store, second, "robot2", "robot1")
    connection = sqlite3.connect(tmp_path / HISTORY_FILE_NAME, isolation_level=None)
    connection.executescript(
        "CREATE TABLE kept AS SELECT * FROM new_loads; DROP VIEW link_samples; DROP VIEW all_loads; DROP TABLE new_loads;"
        "DROP TABLE new_instants; PRAGMA user_version = 3;"
        "CREATE TABLE new_loads (link INTEGER NOT NULL, at REAL NOT NULL, capacity_bytes_per_s REAL NOT NULL,"
        " used_bytes_per_s REAL NOT NULL, rtt_ms REAL, PRIMARY KEY (link, at)) STRICT, WITHOUT ROWID;"
        "INSERT INTO new_loads SELECT * FROM kept; DROP TABLE kept;"
        "CREATE VIEW all_loads AS SELECT * FROM loads UNION ALL SELECT * FROM new_loads;"
        "CREATE VIEW link_samples AS SELECT at, edge, robot, capacity_bytes_per_s, used_bytes_per_s, rtt_ms, link"
        " FROM links JOIN all_loads USING (link);"
    )
    connection.close()
    warnings: list[str] = []
    with Store.open(tmp_path, warn=warnings.append) as store:
        record(store, 70, "robot2", "robot1")
        for robot in ("robot1", "robot2"):
            assert [point.at - NOW for point in store.link_points(robot=robot)] == list(range(71))
    assert warnings == []
