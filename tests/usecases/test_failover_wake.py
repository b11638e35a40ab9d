# SPDX-License-Identifier: Apache-2.0
"""When a watch looks again for the sake of a silent host. Pure."""

from typing import Any

import pytest

from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.task import UnreachablePolicy
from edgectl.usecases.failover_wake import (
    FailoverStage,
    compute_stage,
    find_next_stage_s,
    has_advanced,
    list_failover_times,
    list_rested_hosts,
)
from tests.builders import a_task, some_tasks

PROBE_S = 10.0


def test_the_first_task_of_each_host_counts_and_only_those_that_are_replaced() -> None:
    rule: dict[str, Any] = {"on_unreachable": UnreachablePolicy.REPLACE, "replace_after": 0.0}
    tasks = some_tasks(
        a_task("slow", self_fence=60.0, **rule), a_task("fast", self_fence=30.0, **rule), a_task("held")
    )
    hosts = {"slow": "edge1", "fast": "edge1", "held": "edge2", "gone": "edge3"}
    placements = {task: Placement(host=host, since=0.0) for task, host in hosts.items()}
    contact = dict.fromkeys(("edge1", "edge2", "edge3"), 100.0)
    grace = tasks.tasks["fast"].stop.grace
    manager = ManagerState(placements=placements, contact=contact)
    assert list_failover_times(tasks, manager, 105.0) == {"edge1": pytest.approx(35.0 + grace)}
    assert list_failover_times(tasks, manager, 1000.0) == {"edge1": 0.0}
    fenced = ManagerState(placements=placements, contact=contact, fenced=frozenset({"edge1"}))
    assert list_failover_times(tasks, fenced, 105.0) == {}


@pytest.mark.parametrize(
    ("left_s", "stage"),
    [
        (11.1, FailoverStage.FRESH),
        (11.0, FailoverStage.SUSPECTED),
        (0.01, FailoverStage.SUSPECTED),
        (0.0, FailoverStage.DUE),
    ],
)
def test_a_host_is_asked_once_more_one_probe_before(left_s: float, stage: FailoverStage) -> None:
    assert compute_stage(left_s, PROBE_S) is stage


def test_the_next_stage_is_what_is_waited_for() -> None:
    assert find_next_stage_s({}, PROBE_S) is None
    assert find_next_stage_s({"edge1": 0.0}, PROBE_S) is None
    assert find_next_stage_s({"edge1": 41.0, "edge2": 100.0}, PROBE_S) == pytest.approx(30.01)
    assert find_next_stage_s({"edge1": 4.0, "edge2": 30.0}, PROBE_S) == pytest.approx(4.01)


def test_a_cycle_begins_where_a_host_advanced_and_not_where_it_was_heard_of() -> None:
    fresh, suspected, due = FailoverStage
    assert has_advanced({}, {"edge1": suspected})
    assert has_advanced({"edge1": suspected}, {"edge1": due})
    assert not has_advanced({"edge1": suspected}, {"edge1": fresh})
    assert not has_advanced({"edge1": due}, {"edge1": due})


def test_a_host_is_left_alone_until_its_moment_and_then_asked_again() -> None:
    times = {"edge1": 4.0, "edge2": 40.0, "edge3": 0.0}
    assert list_rested_hosts(times, {"edge3": FailoverStage.SUSPECTED}, PROBE_S) == {
        "edge1": 5.0,
        "edge3": 1.0,
    }
    assert list_rested_hosts(times, {"edge3": FailoverStage.DUE}, PROBE_S) == {"edge1": 5.0}
