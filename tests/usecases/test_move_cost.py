# SPDX-License-Identifier: Apache-2.0
"""Measured downtimes of moves affect later moves (ADR 18), with the real apply, manager state and scheduler."""

from pathlib import Path

from edgectl.model.assignment import Decision, Reason
from edgectl.model.policy import Policy
from edgectl.usecases.apply import plan_and_apply
from edgectl.usecases.plan import make_plan
from tests.builders import a_task, some_tasks
from tests.usecases.test_usecases import Bench

POLICY = Policy()
# slam gains 0.05 on an idle host over one of four cores with 0.8 in use: less than the margin.
SMALL = 0.8


def drive_away(bench: Bench, times: int) -> None:
    """Load the host of slam until it leaves, several times, ten minutes apart."""
    for _ in range(times):
        here = bench.hosts.placed["slam"]
        bench.hosts[here].used = 4.5
        bench.now += 600.0
        plan_and_apply(bench.fleet, POLICY)
        assert bench.hosts.placed["slam"] != here
        bench.hosts[here].used = 0.0


def decide_slam(bench: Bench, cost: float) -> Decision:
    """Return the decision on slam, on a host a little busier than the other, with a downtime cost."""
    bench.hosts[bench.hosts.placed["slam"]].used = SMALL
    bench.now += 600.0
    tasks = some_tasks(a_task("slam", robots=["robot1"], downtime_cost=cost))
    return make_plan(bench.with_tasks(tasks), POLICY).steps[0].decision


def test_after_five_measured_moves_their_downtime_decides(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.fleet = bench.with_tasks(some_tasks(a_task("slam", robots=["robot1"])))
    plan_and_apply(bench.fleet, POLICY)
    drive_away(bench, 8)
    assert sorted(map(len, bench.memory.downtimes.values())) == [4, 4]
    assert decide_slam(bench, 10.0).reason is Reason.BELOW_MARGIN
    drive_away(bench, 1)
    assert len(bench.memory.stays["slam"]) == 9
    assert min(bench.memory.stays["slam"]) > 600.0
    cheap, dear = decide_slam(bench, 0.01), decide_slam(bench, 1e6)
    assert (cheap.reason, dear.reason) == (Reason.GAIN_OVER_COST, Reason.COST_ABOVE_GAIN)
    assert cheap.cost is not None
    assert (cheap.cost.stay_s, 0.0 < cheap.cost.downtime_s < 5.0) == (600.0, True)
