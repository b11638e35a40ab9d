# SPDX-License-Identifier: Apache-2.0
"""The samples for measured demand: the newest, of this specification, on these hosts, after the start."""

from pathlib import Path
from typing import Any

from edgectl.model.resource import Usage
from edgectl.model.snapshot import TaskState
from edgectl.state.store import Store
from tests.builders import NOW, a_run, a_sample, a_snapshot


def record_samples(store: Store, at: float, host: str, **changes: Any) -> None:
    run = a_run(**{"started_at": NOW, "spec_hash": "s1", **changes})
    store.record_snapshot(a_snapshot({host: a_sample(tasks={"slam": run})}, taken_at=NOW + at))


def list_cores(store: Store, *hosts: str, limit: int = 100) -> list[float]:
    return [use.used[0] for use in store.steady_usages("slam", hosts, "s1", min_age_s=10.0, limit=limit)]


def test_only_steady_samples_of_this_specification_on_these_hosts(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        record_samples(store, 9, "edge1", used=Usage(cpu=1.0))
        record_samples(store, 10, "edge1", used=Usage(cpu=2.0))
        record_samples(store, 20, "edge1", used=Usage(cpu=3.0), state=TaskState.RUNNING)
        record_samples(store, 30, "edge1", used=Usage(cpu=4.0), state=TaskState.STARTING)
        record_samples(store, 40, "edge1", used=Usage(cpu=5.0), state=TaskState.FAILED)
        record_samples(store, 50, "edge1", used=Usage(cpu=6.0), spec_hash="s2", instance="i2")
        record_samples(store, 60, "edge2", used=Usage(cpu=7.0), instance="i3")
        record_samples(store, 70, "edge3", used=Usage(cpu=8.0), instance="i4")
        assert list_cores(store, "edge1") == [3.0, 2.0]
        assert list_cores(store, "edge1", "edge2") == [7.0, 3.0, 2.0]
        assert list_cores(store, "edge1", "edge2", limit=2) == [7.0, 3.0]
        assert list_cores(store) == []


def test_a_use_is_read_whole(tmp_path: Path) -> None:
    with Store.open(tmp_path) as store:
        record_samples(
            store,
            100,
            "edge1",
            used=Usage(cpu=0.5, memory=7.0, network=30.0),
            links={"robot1": 10.0, "robot2": 20.0},
        )
        (usage,) = store.steady_usages("slam", ["edge1"], "s1", min_age_s=10.0, limit=9)
        assert usage == (NOW + 100, (0.5, 7.0, 30.0), 2)
        assert store.steady_usages("other", ["edge1"], "s1", min_age_s=10.0, limit=9) == ()
