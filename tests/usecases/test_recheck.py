# SPDX-License-Identifier: Apache-2.0
"""Unattended runs measure once more, and longer, before tasks move because of load (ADR 74)."""

from pathlib import Path

import pytest

from edgectl.model.policy import Policy
from edgectl.usecases.apply import RECHECK_WINDOW_S, ApplyOptions, plan_and_apply
from tests.builders import a_task, some_tasks
from tests.executor.fake_fleet import Request
from tests.usecases.test_usecases import Bench

UNATTENDED = Policy(attended=False)


class NoisyBench(Bench):
    """slam runs on a host whose short readings are ``short``, and whose long ones are ``long``."""

    def __init__(self, state: Path, short: float, long: float) -> None:
        super().__init__(state)
        self.fleet = self.with_tasks(some_tasks(a_task("slam", cpu=1.0, robots=["robot1"])))
        plan_and_apply(self.fleet, UNATTENDED)
        self.here = self.hosts.placed["slam"]
        self.windows: list[float] = []
        self.now += 600.0
        host = self.hosts[self.here]

        def measure(request: Request) -> Request:
            window = float(str(request["window_s"]))
            self.windows.append(window)
            host.used = long if window >= RECHECK_WINDOW_S else short
            return host._probe(request)

        host.faults["probe"] = measure

    def apply(self, recheck: float | None) -> str:
        plan_and_apply(self.fleet, UNATTENDED, options=ApplyOptions(recheck_window=recheck))
        return self.hosts.placed["slam"]


@pytest.mark.parametrize(
    ("load", "recheck", "moves"),
    [(0.5, RECHECK_WINDOW_S, False), (4.5, RECHECK_WINDOW_S, True), (0.5, None, True)],
)
def test_a_reading_that_does_not_last_moves_nothing(
    tmp_path: Path, load: float, recheck: float | None, moves: bool
) -> None:
    bench = NoisyBench(tmp_path, 4.5, load)
    assert (bench.apply(recheck) != bench.here) == moves
    assert (RECHECK_WINDOW_S in bench.windows) == (recheck is not None)


def test_a_run_that_moves_nothing_measures_once(tmp_path: Path) -> None:
    bench = NoisyBench(tmp_path, 0.5, 0.5)
    assert bench.apply(RECHECK_WINDOW_S) == bench.here
    assert bench.windows == [0.5]
