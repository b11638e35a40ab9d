# SPDX-License-Identifier: Apache-2.0
"""Reservations: a running task counts for its demand or its measured usage, whichever is more (ADR 0060)."""

from dataclasses import replace

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Reason, Verdict
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.resource import Usage
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.capacities import build_capacities
from edgectl.scheduler.ledger import build_measured_ledger
from edgectl.scheduler.reservation import can_hold
from edgectl.scheduler.task_usage import TaskUsage
from tests.builders import (
    GI,
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    silent,
    some_tasks,
)
from tests.scheduler.fleets import NO_MEMORY, decisions_by_task, hosts_by_task, run_assign

ONE = an_inventory(an_edge())
TWO = an_inventory(an_edge("edge1"), an_edge("edge2"))
CPU = Policy(weights=parse_weights("cpu"))


@pytest.mark.parametrize(
    ("declared", "measured", "age_s", "reserved"),
    [
        (1.0, 0.2, 3600.0, 1.0),  # idle now: it may use 1.0 again at any moment
        (0.3, 1.2, 3600.0, 1.2),  # uses four times what it declares
        (0.3, 1.2, 10.0, 1.2),
        (0.3, 1.2, 9.0, 0.3),  # its start-up is not typical of it
        (None, 1.2, 3600.0, 1.2),  # declares nothing, and nothing is measured yet
    ],
)
def test_what_a_running_task_reserves(
    declared: float | None, measured: float, age_s: float, reserved: float
) -> None:
    run = a_run(used=Usage(cpu=measured), started_at=NOW - age_s)
    snapshot = a_snapshot(edge1=a_sample(used=measured + 0.5, tasks={"slam": run}))
    # a task that is placed first sees .5 of others and the reservation, whatever the names
    for other in ("a-first", "z-last"):
        found = run_assign(ONE, some_tasks(a_task("slam", cpu=declared), a_task(other, cpu=0.1)), snapshot)
        seen = next(entry for entry in decisions_by_task(found)[other].ranking if entry.host == "edge1")
        assert seen.terms["cpu"] == pytest.approx((4.0 - 0.5 - reserved - 0.1) / 4.0)
        assert found.expected["edge1"].used["cpu"] == pytest.approx(0.5 + reserved + 0.1)


def test_a_task_takes_its_measured_usage_along_to_every_host() -> None:
    # edge1: others 2.0; edge2 idle. slam declares .3 and uses 1.2.
    # edge1 (4 - 2 - 1.2) / 4 = .2; edge2 (4 - 1.2) / 4 = .7; with the declaration alone: .425 and .925
    snapshot = a_snapshot(
        edge1=a_sample(used=3.2, tasks={"slam": a_run(used=Usage(cpu=1.2))}), edge2=a_sample()
    )
    found = run_assign(TWO, some_tasks(a_task(cpu=0.3)), snapshot, policy=CPU)
    (slam,) = found.decisions
    assert {entry.host: entry.total for entry in slam.ranking} == pytest.approx({"edge1": 0.2, "edge2": 0.7})
    assert (slam.host, slam.reason) == ("edge2", Reason.GAIN)
    assert slam.amount == pytest.approx(0.5)
    assert found.expected["edge2"].used["cpu"] == pytest.approx(1.2)


@pytest.mark.parametrize("newcomer", ["a-new", "z-new"])
def test_a_host_that_is_used_above_the_declarations_receives_no_task(newcomer: str) -> None:
    """Nine tasks declare .3 cores and use 1.2: the host of 4 is at 283 %, not at 68 %."""
    names = [f"slam{n}" for n in range(9)]
    snapshot = a_snapshot(
        edge1=a_sample(used=10.8 + 0.5, tasks={name: a_run(used=Usage(cpu=1.2)) for name in names}),
        edge2=a_sample(used=3.9),
    )
    tasks = some_tasks(*(a_task(name, cpu=0.3, pin="edge1") for name in names), a_task(newcomer, cpu=0.5))
    decision = decisions_by_task(run_assign(TWO, tasks, snapshot, policy=CPU))[newcomer]
    assert (decision.verdict, decision.reason) == (Verdict.UNPLACED, Reason.NO_FEASIBLE_HOST)


@pytest.mark.parametrize("newcomer", ["a-new", "z-new"])
def test_a_newcomer_evicts_nothing_whatever_its_name(newcomer: str) -> None:
    """``old`` declares 2.5 cores and uses 1.0 for the moment; the newcomer wants 2.0, on edge1 alone."""
    snapshot = a_snapshot(
        edge1=a_sample(used=1.0, tasks={"old": a_run(used=Usage(cpu=1.0), started_at=NOW - 30.0)}),
        edge2=a_sample(),
    )
    tasks = some_tasks(a_task("old", cpu=2.5), a_task(newcomer, cpu=2.0, only=["edge1"]))
    found = run_assign(TWO, tasks, snapshot, policy=CPU)
    assert hosts_by_task(found) == {"old": "edge1", newcomer: None}


def test_what_is_held_for_a_silent_robot_keeps_its_room() -> None:
    inventory = an_inventory(an_edge(), a_robot())
    snapshot = a_snapshot(
        edge1=a_sample(used=0.5, tasks={"slam": a_run(used=Usage(cpu=0.5))}, links={"robot1": a_link()}),
        robot1=silent(a_robot().role),
    )
    tasks = some_tasks(a_task("slam", cpu=3.0, robots=["robot1"]), a_task("web", cpu=1.5))
    found = run_assign(inventory, tasks, snapshot)
    assert decisions_by_task(found)["slam"].verdict is Verdict.HELD
    assert decisions_by_task(found)["web"].verdict is Verdict.UNPLACED
    assert found.expected["edge1"].used["cpu"] == 3.0


def test_policy_paper_counts_the_demand_alone() -> None:
    snapshot = a_snapshot(edge1=a_sample(used=1.7, tasks={"slam": a_run(used=Usage(cpu=1.2))}))
    policy = replace(CPU, name=PolicyName.PAPER)
    (slam,) = run_assign(ONE, some_tasks(a_task(cpu=0.3)), snapshot, policy=policy).decisions
    assert slam.total == pytest.approx((4.0 - 1.7 - 0.3) / 4.0)


@pytest.mark.parametrize(
    ("use", "holds"),
    [
        (TaskUsage(used={"cpu": 1.0, "memory": GI}), True),
        (TaskUsage(used={"cpu": 1.1}), False),
        (TaskUsage(used={"memory": 4 * GI}), False),
        (TaskUsage(links={"robot1": 6e6}), True),
        (TaskUsage(links={"robot1": 7e6}), False),
    ],
)
def test_can_hold(use: TaskUsage, holds: bool) -> None:
    snapshot = a_snapshot(
        edge1=a_sample(used=3.0, used_memory=GI, links={"robot1": a_link(used=4e6)}),
    )
    fleet = build_capacities(an_inventory(an_edge(), a_robot()), snapshot, NO_MEMORY, frozenset())
    assert can_hold(build_measured_ledger(fleet), 0, use) is holds


amounts = st.sampled_from([0.0, 0.2, 0.4, 0.7, 1.1, 1.6, 2.3])


@settings(max_examples=60)
@given(st.lists(st.tuples(amounts, amounts, st.integers(1, 3)), min_size=1, max_size=6), amounts, st.data())
def test_no_newcomer_moves_a_task_within_its_dwell(
    runs: list[tuple[float, float, int]], wanted: float, data: st.DataObject
) -> None:
    """Whatever it is called: what runs and fits with its reservation stays."""
    edges = [f"edge{n}" for n in range(1, 4)]
    inventory = an_inventory(*map(an_edge, edges))
    snapshot = _a_snapshot_of_runs(edges, runs)
    running = [a_task(f"m{number}", cpu=declared) for number, (declared, _, _) in enumerate(runs)]
    alone = hosts_by_task(run_assign(inventory, some_tasks(*running), snapshot, policy=CPU))
    assume(alone == {f"m{n}": f"edge{place}" for n, (_, _, place) in enumerate(runs)})
    name = data.draw(st.sampled_from(["a-new", "m1b", "z-new"]))
    tasks: Tasks = some_tasks(*running, a_task(name, cpu=wanted))
    with_newcomer = hosts_by_task(run_assign(inventory, tasks, snapshot, policy=CPU))
    assert {task: with_newcomer[task] for task in alone} == alone


def _a_snapshot_of_runs(edges: list[str], runs: list[tuple[float, float, int]]) -> Snapshot:
    samples = {}
    for number, edge in enumerate(edges, start=1):
        here = {
            f"m{n}": a_run(used=Usage(cpu=used), started_at=NOW - 60.0)
            for n, (_, used, place) in enumerate(runs)
            if place == number
        }
        samples[edge] = a_sample(used=sum(run.used["cpu"] for run in here.values()), tasks=here)
    return a_snapshot(samples)
