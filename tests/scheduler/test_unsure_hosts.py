# SPDX-License-Identifier: Apache-2.0
"""Hosts on which another manager may have placed a task since this one last saw all hosts: silent ones (ADR 0055), and
those that the inventory lacks (ADR 0068).
"""

from dataclasses import replace
from typing import Any

import pytest

from edgectl.executor.diff import plan_from_assignment
from edgectl.executor.manager_state_update import update_manager_state
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Plan
from edgectl.model.result import Results
from edgectl.model.snapshot import HostSample, TaskState
from edgectl.scheduler.assign import assign
from edgectl.views.reasons import describe_reason
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, silent, some_tasks

TASKS = some_tasks(a_task("slam", cpu=1.0))
NOTHING = Results(revision=1, actions=(), seconds=0.0)
SYNCED = {"edge1": 4, "edge2": 4}


def answering(foreign: int, **run: Any) -> HostSample:
    """A host whose fifth grant it was, and which granted the fleet to another manager as its ``foreign``th."""
    tasks = {"slam": a_run(spec_hash="hash-slam", **run)} if run else {}
    return replace(a_sample(tasks=tasks), grant=5, foreign_grant=foreign)


def plan_with(
    placement: Placement | None, hosts: dict[str, HostSample], fenced: frozenset[str] = frozenset()
) -> Plan:
    inventory = an_inventory(*(an_edge(name) for name in hosts))
    manager = ManagerState(
        managed=True,
        placements={"slam": placement} if placement else {},
        fenced=fenced,
        synced=SYNCED,
    )
    snapshot = a_snapshot(hosts, memory=manager)
    decided = assign(inventory, TASKS, snapshot, manager, TASKS.policy, NOW)
    return plan_from_assignment(inventory, TASKS, snapshot, manager, decided)


ON_EDGE2 = Placement(host="edge2", since=NOW, generation=5)
GIVEN_UP: dict[str, Any] = {"state": TaskState.FAILED, "generation": 5, "given_up": True, "pid": 0}


@pytest.mark.parametrize(
    ("placement", "hosts", "fenced", "action"),
    [
        # The defect: another manager had moved slam from edge2 to edge1, or started it there.
        (ON_EDGE2, {"edge1": silent(), "edge2": answering(5), "edge3": a_sample()}, (), Action.HOLD),
        (None, {"edge1": silent(), "edge2": answering(5), "edge3": a_sample()}, (), Action.HOLD),
        # Nobody else has acted since all hosts were seen; all hosts answer; the silent one is off.
        (ON_EDGE2, {"edge1": silent(), "edge2": answering(4), "edge3": a_sample()}, (), Action.START),
        (ON_EDGE2, {"edge1": answering(5), "edge2": answering(5)}, (), Action.START),
        (ON_EDGE2, {"edge1": silent(), "edge2": answering(5)}, ("edge1",), Action.START),
        # Its one copy is seen alive, or seen to be given up.
        (ON_EDGE2, {"edge1": silent(), "edge2": answering(5, generation=5)}, (), Action.KEEP),
        (ON_EDGE2, {"edge1": silent(), "edge2": answering(5, **GIVEN_UP)}, (), Action.UNPLACED),
    ],
)
def test_a_task_that_another_manager_may_have_placed_on_a_silent_host_is_held(
    placement: Placement | None, hosts: dict[str, HostSample], fenced: tuple[str, ...], action: Action
) -> None:
    plan = plan_with(placement, hosts, frozenset(fenced))
    (step,) = plan.steps
    assert step.action is action
    if action is Action.HOLD:
        assert describe_reason(step) == (
            "hold: may run on edge1, which does not answer: another manager has acted since all hosts were last "
            "seen; edgectl fence edge1 if it is off"
        )
        memory = plan.snapshot.manager or ManagerState()
        after = update_manager_state(memory, plan, TASKS, NOTHING, {}, NOW)
        assert (after.placements, after.synced) == (memory.placements, SYNCED)


@pytest.mark.parametrize(
    ("hosts", "synced"),
    [
        ({"edge1": answering(5), "edge2": answering(5, generation=5)}, {"edge1": 5, "edge2": 5}),
        # Only this manager has acted since: there is nothing to write. A host is missing: it may be out of date.
        ({"edge1": answering(4), "edge2": answering(4, generation=5)}, SYNCED),
        ({"edge1": silent(), "edge2": answering(5, generation=5)}, SYNCED),
    ],
)
def test_a_manager_that_has_noted_what_runs_on_all_hosts_is_up_to_date(
    hosts: dict[str, HostSample], synced: dict[str, int]
) -> None:
    plan = plan_with(None, hosts)
    after = update_manager_state(plan.snapshot.manager or ManagerState(), plan, TASKS, NOTHING, {}, NOW)
    assert after.synced == synced
    assert after.placements["slam"].host == "edge2"


@pytest.mark.parametrize(
    ("foreign", "run", "action"),
    [(5, {}, Action.HOLD), (4, {}, Action.START), (5, {"generation": 5}, Action.KEEP)],
)
def test_a_task_that_may_run_on_a_host_that_only_another_manager_has_is_held(
    foreign: int, run: dict[str, Any], action: Action
) -> None:
    hosts = {"edge1": replace(answering(foreign, **run), foreign_hosts=("edge3",)), "edge2": a_sample()}
    plan = plan_with(None, hosts)
    (step,) = plan.steps
    assert step.action is action
    memory = plan.snapshot.manager or ManagerState()
    assert update_manager_state(memory, plan, TASKS, NOTHING, {}, NOW).synced == SYNCED
    if action is Action.HOLD:
        assert describe_reason(step) == (
            "hold: may run on edge3, which another manager of this fleet has and this inventory lacks: add edge3, "
            "then edgectl fence edge3 if it is off"
        )
