# SPDX-License-Identifier: Apache-2.0
"""What a fleet lacks, whatever the placement."""

from dataclasses import replace

import pytest

from edgectl.model.manager_state import ManagerState
from edgectl.model.resource import Usage
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.shortage import find_shortages
from tests.builders import GI, a_robot, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import run_assign

FLEET = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot(onboard=True))
OVERUSED = {"slam": a_run(used=Usage(cpu=4.5)), "web": a_run(used=Usage(cpu=4.8))}


def two_edges(**used: float) -> Snapshot:
    return a_snapshot(
        edge1=a_sample(used=used.get("edge1", 0.0), tasks={"slam": OVERUSED["slam"]}),
        edge2=a_sample(used=used.get("edge2", 0.0), tasks={"web": OVERUSED["web"]}),
    )


@pytest.mark.parametrize(
    ("snapshot", "tasks", "short"),
    [
        # 4.5 + 4.8 of 8 cores
        (two_edges(edge1=4.5, edge2=4.8), some_tasks(a_task("slam", cpu=0.3), a_task("web", cpu=0.3)), 1.3),
        # 2 x 3 cores wait for 4 + 4 - 3.5: .5 do not
        (
            a_snapshot(edge1=a_sample(used=1.5), edge2=a_sample(used=1.0)),
            some_tasks(a_task("a", cpu=3.0), a_task("b", cpu=3.0)),
            0.5,
        ),
        # a third that fits on its own robot counts nowhere
        (
            a_snapshot(edge1=a_sample(used=4.0), edge2=a_sample(used=4.0), robot1=a_sample()),
            some_tasks(a_task("a", cpu=3.0, robots=["robot1"])),
            None,
        ),
        # within the slack and nothing waits: noise
        (a_snapshot(edge1=a_sample(used=4.2), edge2=a_sample(used=4.1)), some_tasks(), None),
        # it fits, if not on one edge: the fleet has enough
        (a_snapshot(edge1=a_sample(used=2.0), edge2=a_sample(used=2.0)), some_tasks(a_task(cpu=3.0)), None),
    ],
)
def test_the_least_that_would_help(snapshot: Snapshot, tasks: Tasks, short: float | None) -> None:
    found = {each.resource.name: each.amount for each in find_shortages(FLEET, tasks, snapshot)}
    assert found == ({} if short is None else {"cpu": pytest.approx(short)})
    assert run_assign(FLEET, tasks, snapshot).shortages == find_shortages(FLEET, tasks, snapshot)


def test_the_amount_does_not_depend_on_the_order_of_the_files() -> None:
    """The sums differ in their last bit."""
    full = a_snapshot(edge1=a_sample(used=4.0), edge2=a_sample(used=4.0))
    one = some_tasks(a_task("a", cpu=0.2), a_task("b", cpu=1.1), a_task("c", cpu=1.3))
    other = replace(one, tasks=dict(reversed([*one.tasks.items()])))
    assert 0.2 + 1.1 + 1.3 != 1.3 + 1.1 + 0.2
    assert find_shortages(FLEET, one, full) == find_shortages(FLEET, other, full)


def test_a_closed_edge_is_neither_load_nor_capacity() -> None:
    snapshot = a_snapshot(edge1=a_sample(used_memory=4 * GI), edge2=a_sample(used_memory=3 * GI))
    tasks = some_tasks(a_task(memory=1.5 * GI))
    manager = ManagerState(cordons=frozenset({"edge1"}))
    found = run_assign(FLEET, tasks, snapshot, memory=manager)
    assert [(each.resource.name, each.amount) for each in found.shortages] == [("memory", 0.5 * GI)]
    assert found.shortages[0].describe() == (
        "the edges are short of 512.0Mi of memory: the least that would help"
    )
