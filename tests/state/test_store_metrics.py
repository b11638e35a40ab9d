# SPDX-License-Identifier: Apache-2.0
"""Application metrics in the history: stored on change, by start, within bounds, also in a file of an older
edgectl.
"""

import sqlite3
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from edgectl.errors import StateError
from edgectl.model.point import MetricPoint
from edgectl.model.snapshot import Snapshot
from edgectl.state import store_rows as rows
from edgectl.state.store import Retention, Store
from edgectl.state.store_file import HISTORY_FILE_NAME, SCHEMA_VERSION
from tests.builders import NOW, a_sample, a_snapshot
from tests.state.test_store import a_task


def a_metrics_snapshot(second: float, metrics: Mapping[str, float], **changes: object) -> Snapshot:
    """A snapshot with these metrics of slam."""
    return a_snapshot(
        taken_at=NOW + second,
        edge1=a_sample(tasks={"slam": a_task(metrics=metrics, **changes), "nav": a_task()}),
    )


def list_points(store: Store) -> list[MetricPoint]:
    return list(store.stream(rows.METRICS, "metric_samples", "at, name"))


def list_metrics(store: Store) -> list[tuple[float, str, float]]:
    return [(point.at - NOW, point.name, point.value) for point in list_points(store)]


def test_a_value_is_kept_when_it_changes(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        for second, fps in enumerate([29.5, 29.5, 30.0, 30.0, 29.5]):
            store.record_snapshot(a_metrics_snapshot(second, {"fps": fps, "map/loss": -1e300}))
        store.record_snapshot(a_metrics_snapshot(5, {}))
        store.record_snapshot(a_metrics_snapshot(6, {"fps": 29.5}))
        assert list_metrics(store) == [
            (0, "fps", 29.5),
            (0, "map/loss", -1e300),
            (2, "fps", 30.0),
            (4, "fps", 29.5),
        ]
        assert {(point.task, point.host, point.instance) for point in list_points(store)} == {
            ("slam", "edge1", "i1")
        }


def test_the_same_snapshot_again_changes_nothing(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        for _ in range(2):
            for second, fps in enumerate([1.0, 2.0, 2.0]):
                store.record_snapshot(a_metrics_snapshot(second, {"fps": fps}))
        assert list_metrics(store) == [(0, "fps", 1.0), (1, "fps", 2.0)]


def test_every_start_has_values_of_its_own(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        for second, instance in enumerate(["i1", "i1", "i2", "i2"]):
            store.record_snapshot(a_metrics_snapshot(second, {"fps": 1.0}, instance=instance))
        assert [(point.at - NOW, point.instance) for point in list_points(store)] == [(0, "i1"), (2, "i2")]


def test_old_values_go_as_samples_do(tmp_path: Path) -> None:
    with Store.open(tmp_path, retention=Retention(samples_s=10)) as store:
        store.record_snapshot(a_metrics_snapshot(0, {"fps": 1.0, "loss": 1.0}))
        store.record_snapshot(a_metrics_snapshot(50, {"fps": 2.0, "loss": 1.0}))
        store.prune(NOW + 55)
        assert list_metrics(store) == [(50, "fps", 2.0)]
        store.prune(NOW + 100)
        assert list_metrics(store) == []
        store.record_snapshot(a_metrics_snapshot(101, {"fps": 2.0}))
        assert list_metrics(store) == [(101, "fps", 2.0)]
    left = dict(
        list_columns(
            tmp_path, "SELECT 'metrics', count(*) FROM metrics UNION SELECT 'starts', count(*) FROM starts"
        )
    )
    assert left == {"metrics": 1, "starts": 2}


def list_columns(directory: Path, sql: str) -> list[tuple[Any, ...]]:
    connection = sqlite3.connect(directory / HISTORY_FILE_NAME)
    try:
        return connection.execute(sql).fetchall()
    finally:
        connection.close()


def test_much_that_is_said_does_not_make_the_file_larger_than_it_may_be(tmp_path: Path) -> None:
    most = 200_000
    with Store.open(tmp_path, retention=Retention(max_bytes=most)) as store:
        for second in range(300):
            store.record_snapshot(
                a_metrics_snapshot(second, {f"m{number}": second + number for number in range(32)})
            )
        store.prune(NOW + 300)
        kept = list_metrics(store)
        assert kept[-1][0] == 299
        assert 32 < len(kept) < 32 * 300
    assert (tmp_path / HISTORY_FILE_NAME).stat().st_size <= most


def an_older_history(directory: Path) -> None:
    """A history as an older edgectl left it: with samples, and without a table for metrics."""
    with Store.open(directory) as store:
        store.record_snapshot(a_metrics_snapshot(0, {"fps": 1.0}))
    connection = sqlite3.connect(directory / HISTORY_FILE_NAME, isolation_level=None)
    connection.executescript(
        "DROP VIEW link_samples; DROP VIEW all_loads; DROP TABLE new_loads; DROP TABLE new_instants; DROP VIEW metric_samples;"
        "DROP TABLE readings; DROP TABLE metrics; PRAGMA user_version = 1;"
        "CREATE VIEW link_samples AS SELECT at, edge, robot, capacity_bytes_per_s, used_bytes_per_s, rtt_ms, link"
        " FROM links JOIN loads USING (link);"
    )
    connection.close()


def test_a_history_of_an_older_edgectl_is_kept_and_goes_on(tmp_path: Path) -> None:
    an_older_history(tmp_path)
    warnings: list[str] = []
    with Store.open(tmp_path, warn=warnings.append) as store:
        assert list_metrics(store) == []
        store.record_snapshot(a_metrics_snapshot(1, {"fps": 2.0}))
        assert list_metrics(store) == [(1, "fps", 2.0)]
        assert [point.at - NOW for point in store.task_points("slam")] == [0, 1]
    assert warnings == []
    assert list_columns(tmp_path, "PRAGMA user_version") == [(SCHEMA_VERSION,)]


def test_several_may_bring_it_up_to_date_at_once(tmp_path: Path) -> None:
    an_older_history(tmp_path)
    warnings: list[str] = []
    ready = threading.Barrier(4)

    def bring(number: int) -> None:
        ready.wait(timeout=60)
        with Store.open(tmp_path, warn=warnings.append) as store:
            store.record_snapshot(a_metrics_snapshot(number, {"fps": float(number)}))

    threads = [threading.Thread(target=bring, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert warnings == []
    with Store.open(tmp_path) as store:
        assert len(list_metrics(store)) == 4


@pytest.mark.parametrize("value", ["'x'", "9e999", "-9e999"])
def test_a_value_that_edgectl_did_not_write_is_damage(tmp_path: Path, value: str) -> None:
    with Store.open(tmp_path) as store:
        store.record_snapshot(a_metrics_snapshot(0, {"fps": 1.0}))
    connection = sqlite3.connect(tmp_path / HISTORY_FILE_NAME, isolation_level=None)
    connection.executescript(
        "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql = replace(sql, ') STRICT,', ')') WHERE name = 'readings';"
    )
    connection.close()
    connection = sqlite3.connect(tmp_path / HISTORY_FILE_NAME, isolation_level=None)
    connection.execute(f"UPDATE readings SET value = {value}")
    connection.close()
    with Store.open(tmp_path) as store, pytest.raises(StateError, match="cannot be read to its end"):
        list_points(store)
