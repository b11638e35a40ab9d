# SPDX-License-Identifier: Apache-2.0
"""A task that just fits under noisy readings, in the real loops: `apply` from cron, and `watch`."""

from pathlib import Path

from edgectl.model.policy import Policy
from edgectl.usecases.apply import RECHECK_WINDOW_S, ApplyOptions, plan_and_apply
from edgectl.usecases.fleet import Fleet
from tests.builders import NOW
from tests.executor.fake_fleet import FakeFleet
from tests.usecases.noisy_readings import EDGES, NoisyReadings, build_inventory, build_tasks
from tests.usecases.watch_site import WatchSite


class CronSite:
    """A run every minute, over noisy readings of ``resource``."""

    def __init__(self, state: Path, resource: str = "cpu", **noise: float) -> None:
        state.mkdir(exist_ok=True)
        self.state, self.now = state, NOW
        self.hosts = FakeFleet.of([*EDGES, "robot1"])
        self.readings = NoisyReadings(self.hosts, lambda: self.now, resource=resource, **noise)  # type: ignore[arg-type]
        self.tasks = build_tasks(resource)

    def run(self, runs: int, *, recheck: float | None = RECHECK_WINDOW_S) -> int:
        """The moves in ``runs``, each with the files alone."""
        moves = 0
        for _ in range(runs):
            before = self.readings.home
            fleet = Fleet(
                inventory=build_inventory(),
                tasks=self.tasks,
                transport=self.hosts.transport,
                state=self.state,
                clock=lambda: self.now,
            )
            plan_and_apply(fleet, Policy(attended=False), options=ApplyOptions(recheck_window=recheck))
            moves += bool(before) and self.readings.home != before
            self.now += 60.0
        return moves


def watch_tight_site(
    state: Path, resource: str, cycles: int, *, crowded: bool = False, **noise: float
) -> int:
    """The moves that a watch of ``cycles`` makes. ``crowded``: from the second one on no edge has room for the
    task, with or without it.
    """
    state.mkdir(exist_ok=True)
    site = WatchSite(state, tasks=build_tasks(resource), inventory=build_inventory())
    readings = NoisyReadings(site.hosts, lambda: NOW + site.hands.seconds, resource=resource, **noise)  # type: ignore[arg-type]
    moves, before = 0, ""
    for cycle in site.watch(cycles):
        assert not cycle.error
        moves += bool(before) and readings.home != before
        before = readings.home
        if crowded:
            readings.base = dict.fromkeys(readings.base, 1.1)
    assert before in ("zeta", "beta")
    return moves
