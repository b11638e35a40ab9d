# SPDX-License-Identifier: Apache-2.0
"""A plan that replaces a task is refused if its old host was reachable in the meantime."""

import pytest

from edgectl.executor.diff import plan_from_assignment
from edgectl.executor.drift import list_drift
from edgectl.model.assignment import Reason
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.task import UnreachablePolicy
from edgectl.scheduler.assign import assign
from tests.builders import NOW, a_sample, a_snapshot, a_task, an_edge, an_inventory, silent, some_tasks

INVENTORY = an_inventory(an_edge("edge1"), an_edge("edge2"))
SNAPSHOT = a_snapshot(edge1=silent(), edge2=a_sample())
TASKS = some_tasks(a_task(on_unreachable=UnreachablePolicy.REPLACE, self_fence=60.0))


def a_manager_state(contact: float, *fenced: str) -> ManagerState:
    placements = {"slam": Placement(host="edge1", since=NOW - 900.0)}
    return ManagerState(
        managed=True, placements=placements, contact={"edge1": NOW - contact}, fenced=frozenset(fenced)
    )


@pytest.mark.parametrize(
    ("before", "after", "refused"),
    [
        (a_manager_state(500.0), a_manager_state(500.3), False),  # the same contact, read again
        (a_manager_state(500.0), a_manager_state(20.0), True),
        (a_manager_state(20.0, "edge1"), a_manager_state(20.0, "edge1"), False),
        (a_manager_state(20.0, "edge1"), a_manager_state(20.0), True),  # unfenced by the operator
    ],
)
def test_a_replacing_plan_holds_only_while_its_host_stays_silent(
    before: ManagerState, after: ManagerState, refused: bool
) -> None:
    plan = plan_from_assignment(
        INVENTORY, TASKS, SNAPSHOT, before, assign(INVENTORY, TASKS, SNAPSHOT, before, TASKS.policy, NOW)
    )
    assert plan.steps[0].decision.reason is Reason.REPLACED
    changes = list_drift(plan, SNAPSHOT, after)
    assert changes == (("edge1 answered since, or is no longer fenced",) if refused else ())
