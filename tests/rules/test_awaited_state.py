# SPDX-License-Identifier: Apache-2.0
"""What counts as ready, completed and gone."""

from dataclasses import replace

import pytest

from edgectl.model.check import Check
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState
from edgectl.rules.awaited_state import AwaitedState, find_progress
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, silent

READY, COMPLETED, GONE = AwaitedState.READY, AwaitedState.COMPLETED, AwaitedState.GONE
SLAM = replace(a_task("slam"), spec_hash="s1")
CHECKED = replace(SLAM, ready=Check(command="true"))
PLACED = ManagerState(placements={"slam": Placement(host="edge1", since=NOW, spec_hash="s1")})
DONE = ManagerState(done={"slam": "s1"})


def see(*runs: TaskSample, memory: ManagerState | None = None) -> Snapshot:
    hosts: dict[str, HostSample] = {
        f"edge{number}": a_sample(tasks={"slam": run}) for number, run in enumerate(runs, 1)
    }
    return a_snapshot(hosts or {"edge1": a_sample()}, memory=memory)


@pytest.mark.parametrize(
    ("state", "reached"),
    [
        (TaskState.READY, {READY}),
        (TaskState.STARTING, set()),
        (TaskState.RUNNING, set()),
        (TaskState.UNHEALTHY, set()),
        (TaskState.COMPLETED, {COMPLETED, GONE}),
        (TaskState.FAILED, {GONE}),
        (TaskState.CRASHLOOP, {GONE}),
    ],
)
def test_each_state_of_a_task_with_a_ready_check(state: TaskState, reached: set[AwaitedState]) -> None:
    snapshot = see(a_run(state, given_up=state is TaskState.CRASHLOOP))
    found = {awaited: find_progress("slam", CHECKED, awaited, snapshot) for awaited in AwaitedState}
    assert {awaited for awaited, each in found.items() if each.reached} == reached
    failed = {TaskState.FAILED, TaskState.CRASHLOOP}
    assert {awaited for awaited, each in found.items() if each.failed} == (
        {READY, COMPLETED} if state in failed else set()
    )


def test_a_task_without_a_ready_check_is_ready_once_it_runs() -> None:
    found = find_progress("slam", SLAM, READY, see(a_run(TaskState.RUNNING)))
    assert (found.reached, found.state, found.host) == (True, "running", "edge1")


def test_the_living_instance_counts_beside_one_that_has_ended() -> None:
    snapshot = see(a_run(TaskState.FAILED, generation=9), a_run(TaskState.READY, generation=2))
    assert find_progress("slam", CHECKED, READY, snapshot).host == "edge2"
    assert not find_progress("slam", CHECKED, GONE, snapshot).reached


def test_a_task_on_a_silent_host_is_not_gone() -> None:
    snapshot = a_snapshot(edge1=silent(), edge2=a_sample(), memory=PLACED)
    found = find_progress("slam", SLAM, GONE, snapshot)
    assert (found.reached, found.state, found.host) == (False, "unknown", "edge1")


def test_a_task_on_a_host_that_left_the_inventory_is_not_gone() -> None:
    found = find_progress("slam", SLAM, GONE, a_snapshot(edge2=a_sample(), memory=PLACED))
    assert (found.reached, found.state) == (False, "unknown")


def test_a_task_that_nobody_knows_is_gone_and_not_completed() -> None:
    assert find_progress("slam", SLAM, GONE, see()).reached
    assert not find_progress("slam", SLAM, COMPLETED, see()).reached


@pytest.mark.parametrize(("spec_hash", "reached"), [("s1", True), ("s2", False)])
def test_a_mark_of_completion_counts_for_the_specification_it_was_given(
    spec_hash: str, *, reached: bool
) -> None:
    task = replace(SLAM, spec_hash=spec_hash)
    assert find_progress("slam", task, COMPLETED, see(memory=DONE)).reached is reached
