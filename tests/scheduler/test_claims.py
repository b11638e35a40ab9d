# SPDX-License-Identifier: Apache-2.0
"""What a host reports about a task, against what the manager itself knows of it."""

import pytest

from edgectl.model.inventory import Host
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import HostSample, TaskSample, TaskState
from edgectl.model.task import Task
from edgectl.scheduler.claims import Record, Standing, describe_claims, judge_report
from tests.builders import (
    NOW,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)

EVIL, HASH, FAR = an_edge("evil"), "hash-slam", 1 << 32
ALIVE, DONE = (
    a_run(generation=FAR, spec_hash=HASH),
    a_run(TaskState.COMPLETED, generation=FAR, spec_hash=HASH),
)
NO_HASH = a_run(TaskState.COMPLETED, generation=FAR)
GIVEN_UP = a_run(TaskState.FAILED, generation=FAR, given_up=True, spec_hash=HASH)
RUNS, GONE = a_sample(tasks={"slam": a_run(generation=5)}), a_sample()
TOLD = a_sample(tasks={"slam": a_run(TaskState.FAILED, generation=6)})


def placed(host: str, holder: HostSample | None = None, instance: str = "") -> Record:
    placement = Placement(host=host, since=NOW, spec_hash=HASH, generation=5, instance=instance)
    return Record(placement=placement, holder=holder)


PLACED, ADOPTED, REFUSED = Standing.PLACED, Standing.ADOPTED, Standing.REFUSED


@pytest.mark.parametrize(
    ("report", "record", "standing"),
    [
        # the manager placed it on this host
        (ALIVE, placed("evil"), PLACED),
        (a_run(spec_hash="older"), placed("evil"), PLACED),
        (DONE, placed("evil", instance="instance-1"), PLACED),
        (a_run(TaskState.COMPLETED, spec_hash=HASH), placed("evil", instance="another"), REFUSED),
        # a failed move starts the old instance anew, under the generation of the move
        (
            a_run(TaskState.COMPLETED, spec_hash=HASH, generation=5),
            placed("evil", instance="another"),
            PLACED,
        ),
        (NO_HASH, placed("evil"), REFUSED),
        (a_run(TaskState.COMPLETED, spec_hash="older"), placed("evil"), REFUSED),
        (GIVEN_UP, placed("evil"), PLACED),
        # .. on another one, which runs it, or does not run it any more
        *((report, placed("a", RUNS), REFUSED) for report in (ALIVE, DONE, NO_HASH, GIVEN_UP)),
        *((report, placed("a", GONE), REFUSED) for report in (ALIVE, DONE, NO_HASH, GIVEN_UP)),
        # .. on another one, which another manager told to stop it since
        (ALIVE, placed("a", TOLD), ADOPTED),
        (DONE, placed("a", TOLD), ADOPTED),
        (NO_HASH, placed("a", TOLD), REFUSED),
        # .. on another one, which is silent
        (ALIVE, placed("a"), ADOPTED),
        *((report, placed("a"), REFUSED) for report in (DONE, NO_HASH, GIVEN_UP)),
        # the manager's state was lost
        (ALIVE, None, ADOPTED),
        (DONE, None, ADOPTED),
        (NO_HASH, None, REFUSED),
        (a_run(TaskState.COMPLETED, spec_hash="older"), None, REFUSED),
        (a_run(TaskState.FAILED, given_up=True), None, REFUSED),
    ],
)
def test_what_a_report_counts(report: TaskSample, record: Record | None, standing: Standing) -> None:
    assert judge_report(a_task(), EVIL, report, record) is standing


@pytest.mark.parametrize(
    ("task", "host"),
    [
        (a_task(never=["evil"]), EVIL),
        (a_task(only=["a"]), EVIL),
        (a_task(pin="a"), EVIL),
        (a_task(robots=["robot2"]), a_robot("robot1", onboard=True)),
        (a_task(robots=["robot1"]), a_robot("robot1")),
    ],
)
@pytest.mark.parametrize("report", [ALIVE, DONE])
def test_without_a_record_the_rules_of_the_task_decide(task: Task, host: Host, report: TaskSample) -> None:
    assert judge_report(task, host, report, None) is REFUSED
    assert judge_report(task, host, report, placed("a", TOLD)) is REFUSED


def test_what_does_not_count_and_what_is_taken_over_is_told() -> None:
    inventory, tasks = an_inventory(an_edge("a"), EVIL), some_tasks(a_task())
    known = ManagerState(placements={"slam": Placement(host="a", since=NOW, generation=5)})
    lies = a_snapshot(a=RUNS, evil=a_sample(tasks={"slam": ALIVE}))
    assert list(describe_claims(inventory, tasks, lies, known)) == [
        "evil reports slam as ready, but it is placed on a: the report does not count, and the copy is stopped"
    ]
    lost = a_snapshot(a=RUNS, evil=GONE)
    assert list(describe_claims(inventory, tasks, lost, ManagerState())) == [
        "a runs slam, but no record here places it there: it is taken over"
    ]
    earlier = a_sample(tasks={"slam": a_run(TaskState.COMPLETED, generation=4, spec_hash=HASH)})
    assert list(describe_claims(inventory, tasks, a_snapshot(a=RUNS, evil=earlier), known)) == []
