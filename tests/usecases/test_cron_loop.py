# SPDX-License-Identifier: Apache-2.0
"""`apply` from cron in a closed loop: each run begins with nothing but the state folder, and readings are noisy (ADR 95)."""

import math
from pathlib import Path
from random import Random

import pytest

from edgectl.model.policy import Policy
from edgectl.usecases.apply import RECHECK_WINDOW_S, ApplyOptions, plan_and_apply
from edgectl.usecases.fleet import Fleet
from tests.builders import NOW, a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.fake_fleet import FakeFleet, Request

CORES, DEMAND, USED = 4.0, 2.0, 1.7


class CronSite:
    """One task that just fits, on three edges in reverse order of which two have 0.5 % to spare beside it.

    Each half second of a reading is off by an error with ``deviation`` (share of the host) that lasts for some
    ``lasts`` seconds; a probe is the mean of its window.
    """

    def __init__(self, state: Path, deviation: float, lasts: float, seed: int = 1) -> None:
        state.mkdir(exist_ok=True)
        self.state, self.deviation, self.lasts = state, deviation, lasts
        self.now, self.extra = NOW, 0.0
        self.hosts = FakeFleet.of(["zeta", "beta", "alpha", "robot1"])
        self.errors = dict.fromkeys(("zeta", "beta", "alpha"), 0.0)
        # Each its own: hosts are probed at once, in any order.
        self.dice = {name: Random(f"{seed} {name}") for name in self.errors}
        self.base = {"zeta": CORES * 0.995 - DEMAND, "beta": CORES * 0.995 - DEMAND, "alpha": CORES * 0.9}
        self.seen = dict.fromkeys(self.base, NOW)
        for name in self.base:
            self.hosts[name].faults["probe"] = lambda request, name=name: self._measure(name, request)  # type: ignore[misc]

    def _measure(self, name: str, request: Request) -> Request:
        host, window = self.hosts[name], float(str(request["window_s"]))
        total, halves = 0.0, max(1, round(window / 0.5))
        for _ in range(halves):
            kept = math.exp(-(self.now - self.seen[name] + 0.5) / self.lasts) if self.lasts else 0.0
            self.seen[name] = self.now
            step = self.dice[name].gauss(0.0, self.deviation * math.sqrt(1.0 - kept * kept))
            self.errors[name] = kept * self.errors[name] + step
            total += self.errors[name]
        there = "slam" in host.tasks
        extra = self.extra if name == self.home else 0.0
        host.used = max(0.0, self.base[name] + USED * there + extra + CORES * total / halves)
        if there:
            host.tasks["slam"]["used_cores"] = USED
        return host._probe(request)

    @property
    def home(self) -> str:
        return self.hosts.placed.get("slam", "")

    def run(self, runs: int, *, recheck: float | None = RECHECK_WINDOW_S) -> int:
        """The moves in ``runs``, one a minute; each with the files alone."""
        moves = 0
        for _ in range(runs):
            before = self.home
            fleet = Fleet(
                inventory=an_inventory(*map(an_edge, ("zeta", "beta", "alpha")), a_robot("robot1")),
                tasks=some_tasks(a_task("slam", cpu=DEMAND, robots=["robot1"])),
                transport=self.hosts.transport,
                state=self.state,
                clock=lambda: self.now,
            )
            plan_and_apply(fleet, Policy(attended=False), options=ApplyOptions(recheck_window=recheck))
            moves += bool(before) and self.home != before
            self.now += 60.0
        return moves


@pytest.mark.parametrize("recheck", [None, RECHECK_WINDOW_S])
def test_a_task_that_just_fits_stays_for_an_hour(tmp_path: Path, recheck: float | None) -> None:
    """Readings off by 2 %: within the slack, also raw."""
    assert CronSite(tmp_path, 0.012, 0.0).run(60, recheck=recheck) == 0


def test_errors_that_outlast_a_reading_are_smoothed_over_the_last_minutes(tmp_path: Path) -> None:
    """Off by 12 % for half a minute: a single reading moves the task to and fro, the history does not."""
    raw = CronSite(tmp_path / "raw", 0.12, 30.0)
    assert raw.run(60, recheck=None) > 2
    calm = CronSite(tmp_path / "calm", 0.12, 30.0)
    calm.run(10)  # until there is a history
    assert calm.run(50) == 0


def test_a_load_that_lasts_is_answered_within_three_runs(tmp_path: Path) -> None:
    site = CronSite(tmp_path, 0.012, 0.0)
    site.run(12)
    site.base["beta" if site.home == "zeta" else "zeta"] -= 1.5
    site.extra = 0.8
    assert site.run(3) == 1
    assert site.run(10) == 0
