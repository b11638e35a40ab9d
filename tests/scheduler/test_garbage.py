# SPDX-License-Identifier: Apache-2.0
"""The cyclic collector rests while a plan is made, which leaves nothing for it to find (ADR 103)."""

import gc
from collections.abc import Callable
from dataclasses import replace

import pytest

from edgectl.model.assignment import Assignment
from edgectl.model.policy import Policy
from edgectl.scheduler.garbage import pause_collection
from edgectl.solver.highs import make_solver
from tests.pace import patience
from tests.quality.measures import find_best
from tests.scheduler.tight_fleets import build_full_fleet, build_random_fleet


@pytest.mark.parametrize("enabled", [True, False])
def test_the_collector_is_afterwards_as_it_was(enabled: bool) -> None:
    assert gc.isenabled(), "the suite runs with it"
    (gc.enable if enabled else gc.disable)()
    try:
        with pytest.raises(ValueError, match="collector on: False"):
            _fail_in_pause()
        assert gc.isenabled() is enabled
        build_random_fleet(3, 6, seed=1, fill=0.6).assign()
        assert gc.isenabled() is enabled
    finally:
        gc.enable()


@pause_collection()
def _fail_in_pause() -> None:
    raise ValueError(f"collector on: {gc.isenabled()}")


RANDOM = build_random_fleet(5, 20, seed=3, fill=0.7)


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(RANDOM.assign, id="plain"),
        pytest.param(build_full_fleet(5, 20, seed=1).assign, id="repaired"),
        pytest.param(replace(RANDOM, policy=Policy(rebalance=True)).assign, id="rebalanced"),
        pytest.param(lambda: find_best(RANDOM, make_solver(patience(0.2)))[0], id="optimal"),
    ],
)
def test_a_plan_leaves_no_cycles(make: Callable[[], Assignment]) -> None:
    found = make()  # what is imported or kept for good
    assert any(decision.ranking for decision in found.decisions)
    # Several times: other threads of the worker may leave something.
    assert min(_count_cycles_left(make) for _ in range(3)) == 0


def _count_cycles_left(make: Callable[[], Assignment]) -> int:
    gc.collect()
    gc.disable()
    try:
        make()
        return gc.collect()
    finally:
        gc.enable()
