# SPDX-License-Identifier: Apache-2.0
"""When a ready check is tried again."""

import threading
import time
from pathlib import Path

import pytest

from edgectl.agent.supervise import records
from edgectl.agent.supervise.ready import compute_pause_s
from edgectl.agent.supervise.status import pause_until_written, read_written_ns


@pytest.mark.parametrize(
    ("since_s", "took_s", "pause_s"),
    [
        (0.0, 0.0, 0.05),
        (1.0, 0.005, 0.05),
        (1.0, 0.01, 0.08),
        (1.0, 0.02, 0.1),
        (2.0, 0.01, 0.1),
        (2.0, 0.02, 0.16),
        (10.0, 0.01, 0.5),
        (10.0, 0.2, 1.0),
        (100.0, 0.01, 5.0),
        (0.5, 0.3, 1.2),
        (1.0, 9.0, 5.0),
    ],
)
def test_pause_grows_with_the_time_since_the_start_and_with_the_cost(
    since_s: float, took_s: float, pause_s: float
) -> None:
    assert compute_pause_s(since_s, took_s) == pytest.approx(pause_s)


@pytest.mark.parametrize(("took_s", "share", "most"), [(0.02, 0.1, 100), (0.004, 0.05, 100), (0.1, 0.1, 50)])
@pytest.mark.parametrize("ready_s", [0.7, 1.01, 3.3, 12.0, 30.0])
def test_what_is_ready_is_seen_at_most_a_tenth_too_late(
    ready_s: float, took_s: float, share: float, most: int
) -> None:
    tries, at = 0, 0.0
    while at < ready_s:
        tries, at = tries + 1, at + compute_pause_s(at, took_s)
    assert at - ready_s <= share + share * ready_s + 1e-9
    assert tries <= most


def test_who_waits_goes_on_once_the_status_is_written(tmp_path: Path) -> None:
    path = tmp_path / "status"
    records.write_record(str(path), {"state": "starting"})
    written, began = read_written_ns(str(tmp_path)), time.monotonic()
    writer = threading.Timer(0.1, records.write_record, (str(path), {"state": "ready"}))
    writer.start()
    pause_until_written(str(tmp_path), written, 1000.0, 0.01)
    writer.join()
    assert records.read_record(str(path))["state"] == "ready"
    assert time.monotonic() - began < 500.0


@pytest.mark.parametrize("name", ["", "gone"])
def test_who_waits_looks_again_where_nothing_is_written(tmp_path: Path, name: str) -> None:
    folder = str(tmp_path / name) if name else ""
    pause_until_written(folder, read_written_ns(folder), 0.05, 0.01)
    assert read_written_ns(folder) == 0
