# SPDX-License-Identifier: Apache-2.0
"""The cyclic collector rests while a plan is made, which leaves nothing for it to find (ADR 103)."""

import gc
import sys
import weakref
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


class _Node:
    """Part of a cycle."""

    def __init__(self) -> None:
        self.itself = self


def test_what_a_large_plan_makes_is_old_and_what_was_young_before_has_been_looked_at() -> None:
    gc.collect()
    lost = weakref.ref(_Node())
    assert lost() is not None
    with pause_collection(large=True):
        made = _Node()
    assert lost() is None
    assert not any(each is made for each in gc.get_objects(generation=0))
    assert any(each is made for each in gc.get_objects())


@pytest.mark.skipif(sys.version_info >= (3, 14), reason="looks at all objects in parts, and counts no looks")
def test_large_plans_do_not_put_off_the_look_at_all_objects() -> None:
    gc.collect()
    for plans in range(1, 8):
        with pause_collection(large=True):
            pass
        assert gc.get_count()[2] == plans


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
