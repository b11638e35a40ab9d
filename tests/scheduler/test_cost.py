# SPDX-License-Identifier: Apache-2.0
"""Cost of moves (ADR 0018): once five downtimes are measured, a move must pay for its expected downtime.
Worked by hand.
"""

from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Decision, MoveCost, Reason
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import decisions_by_task, run_assign
from tests.scheduler.test_properties import quick

FOUR_S = (2.0, 3.0, 4.0, 5.0, 90.0)  # median 4, regardless of the worst value
INVENTORY = an_inventory(*map(an_edge, ("edge1", "edge2", "edge3")))


def decide_slam(
    gain: float, *, downtimes: Mapping[str, tuple[float, ...]] | None = None, stays: tuple[float, ...] = (), here_s: float = 300.0,
    cost: float = 10.0, min_dwell: float = 0.0, max_moves: int | None = None,
) -> Decision:  # fmt: skip
    """Return the decision on slam, which has been on edge1 for ``here_s`` and would gain ``gain`` on edge2;
    edge3 is full.
    """
    memory = ManagerState(
        managed=True,
        placements={"slam": Placement(host="edge1", since=NOW - here_s)},
        downtimes={("slam", host): seconds for host, seconds in (downtimes or {}).items()},
        stays={"slam": stays} if stays else {},
    )
    samples = a_snapshot(
        edge1=a_sample(used=4 * gain, tasks={"slam": a_run()}), edge2=a_sample(), edge3=a_sample(used=4.0)
    )
    policy = Policy(weights=parse_weights("cpu"), min_dwell=min_dwell, max_moves=max_moves, attended=False)
    return decisions_by_task(
        run_assign(INVENTORY, some_tasks(a_task(downtime_cost=cost)), samples, memory=memory, policy=policy)
    )["slam"]


@pytest.mark.parametrize(
    ("gain", "world", "reason", "needed"),
    [
        # 4 s x 10 /s over 300 s: a move needs a gain of .1333
        (0.13, {}, Reason.COST_ABOVE_GAIN, 4 * 10 / 300),
        (0.14, {}, Reason.GAIN_OVER_COST, 4 * 10 / 300),
        # below the bare margin of .10, and yet worth it over ten minutes
        (0.07, {"here_s": 600.0}, Reason.GAIN_OVER_COST, 4 * 10 / 600),
        (0.06, {"here_s": 600.0}, Reason.COST_ABOVE_GAIN, 4 * 10 / 600),
        # horizon at most ten minutes, at least two
        (0.06, {"here_s": 86400.0}, Reason.COST_ABOVE_GAIN, 4 * 10 / 600),
        (0.30, {"here_s": 1.0}, Reason.COST_ABOVE_GAIN, 4 * 10 / 120),
        (0.34, {"here_s": 1.0}, Reason.GAIN_OVER_COST, 4 * 10 / 120),
        # past stays (mean 200 s) count more than the present one
        (0.19, {"here_s": 600.0, "stays": (100.0, 300.0)}, Reason.COST_ABOVE_GAIN, 4 * 10 / 200),
        (0.21, {"here_s": 600.0, "stays": (100.0, 300.0)}, Reason.GAIN_OVER_COST, 4 * 10 / 200),
        # the cost of downtime is the task's
        (0.02, {"cost": 1.0}, Reason.GAIN_OVER_COST, 4 * 1 / 300),
        (0.90, {"cost": 100.0}, Reason.COST_ABOVE_GAIN, 4 * 100 / 300),
        (0.001, {"cost": 0.0}, Reason.GAIN_OVER_COST, 0.0),
        # exactly its cost is not more than its cost
        (0.25, {"cost": 18.75}, Reason.COST_ABOVE_GAIN, 0.25),
    ],
)
def test_a_measured_move_must_pay_for_its_downtime(
    gain: float, world: dict[str, object], reason: Reason, needed: float
) -> None:
    decision = decide_slam(gain, downtimes={"edge2": FOUR_S}, **world)  # type: ignore[arg-type]
    assert decision.reason is reason
    assert decision.cost is not None
    assert (decision.cost.downtime_s, decision.cost.needed) == pytest.approx((4.0, needed))
    moved = reason is Reason.GAIN_OVER_COST
    assert decision.host == ("edge2" if moved else "edge1")
    assert decision.amount == pytest.approx(gain if moved else needed)


@pytest.mark.parametrize(
    ("downtimes", "seconds"),
    [
        ({"edge2": FOUR_S, "edge3": (9.0,) * 5}, 4.0),  # of the challenger itself
        ({"edge1": (6.0,) * 5}, 6.0),  # of the only host with enough samples
        ({"edge1": (6.0,) * 5, "edge2": (1.0,) * 4, "edge3": (9.0,) * 5}, 9.0),  # of the slowest of them
    ],
)
def test_which_downtime_is_expected(downtimes: Mapping[str, tuple[float, ...]], seconds: float) -> None:
    assert decide_slam(0.05, downtimes=downtimes).cost == MoveCost(
        stay_s=300.0, downtime_s=seconds, per_s=10.0
    )


@quick
@given(st.floats(0.0, 1.0), st.integers(0, 4), st.floats(0.0, 1e4))
def test_with_fewer_than_five_the_bare_margin_decides(gain: float, count: int, cost: float) -> None:
    decision = decide_slam(
        gain, downtimes=dict.fromkeys(("edge1", "edge2", "edge3"), (60.0,) * count), cost=cost
    )
    assert decision.reason in (Reason.STILL_BEST, Reason.BELOW_MARGIN, Reason.GAIN)
    assert (decision.reason is Reason.GAIN) == (gain > 0.1 + 1e-9)
    assert decision.cost is None


@quick
@given(
    st.floats(0.0, 1.0),
    st.floats(0.0, 100.0),
    st.floats(0.0, 100.0),
    st.lists(st.floats(0.0, 1e5), max_size=3),
    st.floats(0.0, 1e5),
)
def test_a_higher_cost_never_moves_what_a_lower_one_keeps(
    gain: float, cost: float, more: float, stays: list[float], here_s: float
) -> None:
    world = {"downtimes": {"edge2": FOUR_S}, "stays": tuple(stays), "here_s": here_s}
    low, high = decide_slam(gain, cost=cost, **world), decide_slam(gain, cost=cost + more, **world)  # type: ignore[arg-type]
    assert low.host == "edge2" or high.host == "edge1"


@pytest.mark.parametrize(
    ("brake", "reason"), [({"min_dwell": 400.0}, Reason.DWELL), ({"max_moves": 0}, Reason.MAX_MOVES)]
)
def test_a_move_that_pays_still_waits_for_the_brakes(brake: dict[str, object], reason: Reason) -> None:
    assert decide_slam(0.9, downtimes={"edge2": FOUR_S}, **brake).reason is reason  # type: ignore[arg-type]


def test_what_no_longer_fits_moves_at_any_cost() -> None:
    decision = decide_slam(1.2, downtimes={"edge2": FOUR_S}, cost=1e6)
    assert (decision.host, decision.reason, decision.cost) == ("edge2", Reason.FORCED_INFEASIBLE, None)
