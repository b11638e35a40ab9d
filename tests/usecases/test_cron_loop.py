# SPDX-License-Identifier: Apache-2.0
"""`apply` from cron, and `watch`, in a closed loop with noisy readings (ADR 95).

Each run of cron begins with nothing but the state folder.
"""

from pathlib import Path

import pytest

from edgectl.usecases.apply import RECHECK_WINDOW_S
from tests.usecases.tight_sites import CronSite, watch_tight_site
from tests.usecases.watch_site import EVERY

RESOURCES = ("cpu", "memory", "network")
# Of the capacity: what readings are off by at most.
OFF_BY_2_PERCENT = 0.02


@pytest.mark.parametrize("resource", RESOURCES)
@pytest.mark.parametrize("recheck", [None, RECHECK_WINDOW_S])
def test_a_task_that_just_fits_stays_for_an_hour_of_cron(
    tmp_path: Path, recheck: float | None, resource: str
) -> None:
    """0.5 % to spare, and readings off by 2 %: within the slack, also raw."""
    assert CronSite(tmp_path, resource, up_to=OFF_BY_2_PERCENT).run(60, recheck=recheck) == 0


@pytest.mark.parametrize("resource", RESOURCES)
def test_a_task_that_just_fits_stays_under_a_watch(tmp_path: Path, resource: str) -> None:
    """A quarter of an hour; `python -m tests.quality Stability` watches for an hour."""
    assert watch_tight_site(tmp_path, resource, int(900 / EVERY), up_to=OFF_BY_2_PERCENT) == 0


@pytest.mark.parametrize("resource", RESOURCES)
def test_a_watch_leaves_a_task_where_no_edge_is_better(tmp_path: Path, resource: str) -> None:
    """All edges are above their capacity: ten minutes."""
    assert watch_tight_site(tmp_path, resource, 60, crowded=True, up_to=OFF_BY_2_PERCENT) == 0


@pytest.mark.parametrize("resource", ["cpu", "network"])
def test_errors_that_outlast_a_reading_are_smoothed_over_the_last_minutes(
    tmp_path: Path, resource: str
) -> None:
    """Off by 12 % for half a minute: a single reading moves the task to and fro, the history does not."""
    raw = CronSite(tmp_path / "raw", resource, deviation=0.12, lasts=30.0)
    assert raw.run(60, recheck=None) > 2
    calm = CronSite(tmp_path / "calm", resource, deviation=0.12, lasts=30.0)
    calm.run(10)  # until there is a history
    assert calm.run(50) == 0


@pytest.mark.parametrize(("resource", "runs"), [("cpu", 3), ("memory", 1), ("network", 3)])
def test_a_load_that_lasts_is_answered_within_three_runs_and_want_of_memory_at_once(
    tmp_path: Path, resource: str, runs: int
) -> None:
    site = CronSite(tmp_path, resource, up_to=OFF_BY_2_PERCENT)
    site.run(12)
    site.readings.base["beta" if site.readings.home == "zeta" else "zeta"] -= 0.375
    site.readings.extra = 0.05 if resource == "memory" else 0.2
    assert site.run(runs) == 1
    assert site.run(10) == 0
