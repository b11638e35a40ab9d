# SPDX-License-Identifier: Apache-2.0
"""Stability: a plan made right after the apply of a settled plan changes nothing."""

import pytest

from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Reason
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from tests.builders import a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import (
    NO_MEMORY,
    decisions_by_task,
    hosts_by_task,
    ranking_by_host,
    run_assign,
    simulate_apply,
)

TWO = an_inventory(an_edge("edge1"), an_edge("edge2"))


def test_a_later_pass_mends_what_the_first_could_not_know() -> None:
    # a comes first and takes edge1 (tie, first by name); b fits on edge1 alone, and pushes it there to (4 - .5 - 3) / 4.
    # Repeated, a sees b: edge1 (4 - 3 - .5) / 4 = .125, edge2 (4 - 0 - .5) / 4 = .875, and moves; the third pass changes nothing.
    tasks = some_tasks(a_task("a", cpu=0.5), a_task("b", cpu=3.0, only=["edge1"]))
    snapshot = a_snapshot(edge1=a_sample(), edge2=a_sample())
    found = run_assign(TWO, tasks, snapshot, policy=Policy(weights=parse_weights("cpu")))
    assert found.settled
    assert hosts_by_task(found) == {"a": "edge2", "b": "edge1"}
    a = decisions_by_task(found)["a"]
    assert a.previous_host is None
    assert a.total == pytest.approx(0.875)
    assert ranking_by_host(a)["edge1"].total == pytest.approx(0.125)


def test_nothing_changes_after_the_apply() -> None:
    tasks = some_tasks(
        a_task("a", cpu=0.5), a_task("b", cpu=3.0, only=["edge1"]), a_task("c", cpu=1.0, needs=["a"])
    )
    snapshot = a_snapshot(edge1=a_sample(used=0.3), edge2=a_sample(used=0.2))
    for min_dwell in (0.0, 120.0):
        policy = Policy(weights=parse_weights("resources"), min_dwell=min_dwell)
        first = run_assign(TWO, tasks, snapshot, policy=policy)
        later, memory = simulate_apply(first, tasks, snapshot, NO_MEMORY)
        again = run_assign(TWO, tasks, later, memory=memory, policy=policy)
        assert hosts_by_task(again) == hosts_by_task(first)
        assert all(d.host == d.previous_host for d in again.decisions)


def test_a_chase_without_end_is_cut_short() -> None:
    # slam leaves the load of its successor, nav follows slam: each move pays more than the margin, forever.
    # slam's turn: its host holds nav (1.2 of 4 cores), the other is empty: cpu gain .3 x .5 = .15 > .10.
    # nav's turn: with slam 1.0 x .5, minus its load (.4 / 4) x .5 = .05: gain .45 > .10.
    tasks = some_tasks(a_task("slam", cpu=0.4), a_task("nav", cpu=1.2, needs=["slam"]))
    both = {"slam": a_run(used=Usage(cpu=0.4)), "nav": a_run(used=Usage(cpu=1.2))}
    snapshot = a_snapshot(edge1=a_sample(used=1.6, tasks=both), edge2=a_sample())
    found = run_assign(TWO, tasks, snapshot, policy=Policy(weights=parse_weights("cpu=.5,task=.5")))
    assert not found.settled
    assert hosts_by_task(found) == {"slam": "edge1", "nav": "edge1"}
    assert decisions_by_task(found)["slam"].reason is Reason.UNSETTLED
    assert decisions_by_task(found)["nav"].reason is Reason.STILL_BEST


def test_a_move_of_a_later_pass_is_told_from_where_the_task_really_runs() -> None:
    # Pass 1: a leaves edge1 (gain), then b, which fits on edge2 alone, comes there; pass 2: a goes on to edge3.
    inventory = an_inventory(an_edge("edge1"), an_edge("edge2"), an_edge("edge3"))
    snapshot = a_snapshot(
        edge1=a_sample(used=3.0, tasks={"a": a_run()}), edge2=a_sample(), edge3=a_sample(used=0.2)
    )
    tasks = some_tasks(a_task("a", cpu=0.5), a_task("b", cpu=3.0, only=["edge2"]))
    found = run_assign(inventory, tasks, snapshot, policy=Policy(weights=parse_weights("cpu")))
    a = decisions_by_task(found)["a"]
    assert found.settled
    assert (a.previous_host, a.host, a.reason) == ("edge1", "edge3", Reason.GAIN)
    # edge1 (4 - 3 - .5) / 4 = .125, edge3 (4 - .2 - .5) / 4 = .825
    assert (a.total, a.amount) == pytest.approx((0.825, 0.7))
