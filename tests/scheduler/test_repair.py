# SPDX-License-Identifier: Apache-2.0
"""Repair: tasks that others can make room for are placed, and nobody else is worse off for it."""

from dataclasses import replace
from itertools import product

import pytest

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Assignment, Reason, Verdict
from edgectl.model.demand import ZERO
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.task import Task, Tasks
from edgectl.scheduler.insertion import place_item
from edgectl.scheduler.packing import Item, Packing, ShareTable
from edgectl.views.reasons import describe_reason
from tests.builders import (
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import NO_MEMORY, decisions_by_task, hosts_by_task, run_assign, simulate_apply
from tests.scheduler.tight_fleets import (
    TightFleet,
    build_full_fleet,
    build_random_fleet,
    count_unplaced,
    enlarge_edge,
)

TWO = an_inventory(an_edge("edge1"), an_edge("edge2"))
# Two edges of 4 cores. small (1 core) runs on edge1, mid (2) on edge2; big (3.5) may run on edge1 alone, and
# fits there once small has gone to edge2.
SMALL, MID = a_task("small", cpu=1.0), a_task("mid", cpu=2.0)
BIG = a_task("big", cpu=3.5, only=["edge1"])


def run_two(*tasks: str, since: float = 3600.0) -> tuple[Snapshot, ManagerState]:
    """Snapshot of two edges with small on edge1 and mid on edge2, ``since`` seconds."""
    place = {"small": ("edge1", 1.0), "mid": ("edge2", 2.0)}
    runs = {
        name: a_run(used=Usage(cpu=place[name][1]), spec_hash=f"hash-{name}", started_at=NOW - since)
        for name in tasks
    }
    memory = ManagerState(
        managed=True,
        placements={name: Placement(host=place[name][0], since=NOW - since) for name in tasks},
    )
    samples = {
        edge: a_sample(
            used=sum(place[name][1] for name in tasks if place[name][0] == edge),
            tasks={name: run for name, run in runs.items() if place[name][0] == edge},
        )
        for edge in ("edge1", "edge2")
    }
    return a_snapshot(samples, memory=memory), memory


def assign_two(tasks: Tasks, *, since: float = 3600.0, policy: Policy | None = None) -> Assignment:
    snapshot, memory = run_two("small", "mid", since=since)
    return run_assign(TWO, tasks, snapshot, memory=memory, policy=policy)


def test_a_running_task_makes_room_and_says_for_whom() -> None:
    found = assign_two(some_tasks(SMALL, MID, BIG))
    assert hosts_by_task(found) == {"small": "edge2", "mid": "edge2", "big": "edge1"}
    by_task = decisions_by_task(found)
    assert (by_task["small"].reason, by_task["small"].subject) == (Reason.MADE_ROOM, "big")
    assert by_task["small"].previous_host == "edge1"
    assert by_task["big"].reason is Reason.ROOM_MADE
    assert by_task["mid"].verdict is Verdict.KEPT
    assert found.settled
    assert not any(decision.overcommitted for decision in found.decisions)
    assert found.expected["edge1"].used["cpu"] == pytest.approx(3.5)
    assert found.expected["edge2"].used["cpu"] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("small", "since", "policy"),
    [
        pytest.param(replace(SMALL, hosts=replace(SMALL.hosts, pin="edge1")), 3600.0, Policy(), id="pinned"),
        pytest.param(SMALL, 60.0, Policy(), id="in its dwell time"),
        pytest.param(replace(SMALL, priority=1.0), 3600.0, Policy(), id="of higher priority"),
        pytest.param(SMALL, 3600.0, Policy(attended=False, max_moves=0), id="no moves left"),
    ],
)
def test_no_room_is_made_by_a_task_that(small: Task, since: float, policy: Policy) -> None:
    found = assign_two(some_tasks(small, MID, BIG), since=since, policy=policy)
    assert hosts_by_task(found) == {"small": "edge1", "mid": "edge2", "big": None}
    assert decisions_by_task(found)["big"].reason is Reason.NO_FEASIBLE_HOST


def test_unattended_one_move_is_enough_for_one_that_makes_room() -> None:
    policy = Policy(attended=False, max_moves=1)
    found = assign_two(some_tasks(SMALL, MID, BIG), policy=policy)
    assert count_unplaced(found) == 0


def test_successors_of_a_task_that_finds_room_are_placed_too() -> None:
    tasks = some_tasks(SMALL, MID, BIG, a_task("last", cpu=0.1, needs=["big"]))
    assert count_unplaced(assign_two(tasks)) == 0


def test_a_task_that_this_plan_starts_gives_way_before_a_running_one() -> None:
    # edge1 runs small (1 core), and new (1) is placed there too: .5 free against .275 on edge2, which has 1.9
    # in use. big (3) then lacks 1 core on edge1; each of the two could give it.
    tasks = some_tasks(SMALL, a_task("a-new", cpu=1.0), a_task("big", cpu=3.0, only=["edge1"]))
    snapshot, memory = run_two("small")
    snapshot = replace(snapshot, hosts={**snapshot.hosts, "edge2": a_sample(used=1.9)})
    by_task = decisions_by_task(run_assign(TWO, tasks, snapshot, memory=memory))
    assert by_task["small"].verdict is Verdict.KEPT
    assert (by_task["a-new"].host, by_task["a-new"].reason) == ("edge2", Reason.MADE_ROOM)
    assert (by_task["a-new"].subject, by_task["big"].host) == ("big", "edge1")


def test_a_task_on_a_dead_link_leaves_no_room_there() -> None:
    one = an_inventory(an_edge("edge1"), an_edge("edge2"), a_robot("robot1", probe=False))
    stuck = a_task("stuck", cpu=1.0, throughput=1e6, robots=["robot1"])
    run = a_run(used=Usage(cpu=1.0), spec_hash="hash-stuck")
    snapshot = a_snapshot(
        edge1=a_sample(used=1.0, links={"robot1": a_link(0.0)}, tasks={"stuck": run}),
        edge2=a_sample(used=4.0, links={"robot1": a_link()}),
    )
    tasks = some_tasks(stuck, replace(stuck, name="new", priority=1.0, preempt=True))
    assert hosts_by_task(run_assign(one, tasks, snapshot)) == {"new": None, "stuck": "edge1"}


LOW = a_task("low", cpu=3.0)


@pytest.mark.parametrize(
    ("priority", "preempt", "host"), [(1.0, True, "edge1"), (1.0, False, None), (0.0, True, None)]
)
def test_a_task_is_preempted_only_by_one_of_higher_priority_that_may(
    priority: float, preempt: bool, host: str | None
) -> None:
    one = an_inventory(an_edge("edge1"))
    tasks = some_tasks(LOW, a_task("high", cpu=2.0, priority=priority, preempt=preempt))
    memory = ManagerState(managed=True, placements={"low": Placement(host="edge1", since=NOW - 3600.0)})
    run = a_run(used=Usage(cpu=3.0), spec_hash="hash-low")
    snapshot = a_snapshot(edge1=a_sample(used=3.0, tasks={"low": run}), memory=memory)
    found = run_assign(one, tasks, snapshot, memory=memory)
    assert hosts_by_task(found) == {"low": None if host else "edge1", "high": host}
    steps = {step.task: step for step in diff_assignment(found, tasks, snapshot, memory)}
    assert steps["low"].action is (Action.STOP if host else Action.KEEP)
    if host:
        assert (steps["low"].decision.reason, steps["low"].decision.subject) == (Reason.PREEMPTED, "high")
        assert steps["low"].instances == {"edge1": "instance-1"}
        assert describe_reason(steps["low"]) == "stop: preempted by high of higher priority"


@pytest.mark.parametrize("seed", range(40))
def test_against_every_placement_of_a_small_fleet(seed: int) -> None:
    fleet = build_random_fleet(3, 7, seed, 0.6 + 0.05 * (seed % 6))
    assert (count_unplaced(fleet.assign()) == 0) == _has_full_placement(fleet)


def _has_full_placement(fleet: TightFleet) -> bool:
    edges = list(fleet.snapshot.hosts.values())
    tasks = list(fleet.tasks.tasks.values())
    return any(
        all(
            _has_room(edge, [task for task, place in zip(tasks, places, strict=True) if place == index])
            for index, edge in enumerate(edges)
        )
        for places in product(range(len(edges)), repeat=len(tasks))
    )


def _has_room(edge: HostSample, tasks: list[Task]) -> bool:
    used = {name: usage.used for name, usage in edge.usage.items()}
    rates = {robot: link.used_bytes_per_s for robot, link in edge.links.items()}
    for task in tasks:
        for name in used:
            used[name] += (task.demand[name] or ZERO).value
        for robot in task.robots:
            rates[robot] += (task.demand["network"] or ZERO).value
    return all(used[name] <= usage.capacity * (1 + 1e-9) for name, usage in edge.usage.items()) and all(
        rates[robot] <= link.capacity_bytes_per_s for robot, link in edge.links.items()
    )


@pytest.mark.parametrize(("edges", "tasks", "fleets"), [(5, 20, 6), (10, 50, 2)])
def test_fleets_that_are_88_to_95_percent_full_are_placed_whole(edges: int, tasks: int, fleets: int) -> None:
    left = {seed: count_unplaced(build_full_fleet(edges, tasks, seed).assign()) for seed in range(fleets)}
    assert not any(left.values()), left


def test_a_larger_edge_never_unplaces() -> None:
    for seed in range(8):
        fleet = build_random_fleet(5, 20, seed, 0.75)
        assert count_unplaced(enlarge_edge(fleet, f"edge{seed % 5 + 1}").assign()) <= count_unplaced(
            fleet.assign()
        )


@pytest.mark.parametrize("min_dwell", [0.0, 120.0])
def test_a_repaired_plan_applied_and_made_again_changes_nothing(min_dwell: float) -> None:
    for seed in range(6):
        fleet = replace(build_full_fleet(5, 20, seed), policy=Policy(min_dwell=min_dwell))
        first = fleet.assign()
        assert any(decision.reason is Reason.ROOM_MADE for decision in first.decisions)
        assert first.settled
        snapshot, memory = simulate_apply(first, fleet.tasks, fleet.snapshot, NO_MEMORY)
        again = replace(fleet, snapshot=snapshot, memory=memory).assign()
        steps = diff_assignment(again, fleet.tasks, snapshot, memory)
        assert {step.action for step in steps} == {Action.KEEP}
        assert hosts_by_task(again) == hosts_by_task(first)


def test_names_do_not_decide_who_is_placed() -> None:
    for seed in range(6):
        fleet = build_full_fleet(4, 12, seed)
        renamed = {
            f"z{index}": replace(task, name=f"z{index}")
            for index, task in enumerate(reversed(list(fleet.tasks.tasks.values())))
        }
        other = replace(fleet, tasks=replace(fleet.tasks, tasks=renamed))
        assert count_unplaced(fleet.assign()) == count_unplaced(other.assign()) == 0


def an_item(name: str, share: float, *places: int) -> Item:
    return Item(name=name, tasks=(name,), places=places, shares=ShareTable(lambda _: {0: share}))


@pytest.mark.parametrize(("work", "found"), [(20, True), (6, False)])
def test_a_chain_of_tasks_makes_room_within_few_looks(work: int, found: bool) -> None:
    # Each place but the last is full: big needs place 0, from where a can only go to 1, b from there only to 2,
    # and c from there only to 3. x and y could leave too, but would lead nowhere.
    a, b, c = an_item("a", 0.5, 0, 1), an_item("b", 0.5, 1, 2), an_item("c", 0.5, 2, 3)
    fixed = [an_item(f"x{place}", 0.5, place) for place in range(4)]
    packing = Packing(
        free=[[1.0] for _ in range(4)], items={}, at={}, home={}, on=[[] for _ in range(4)], work=work
    )
    for item, place in [(a, 0), (b, 1), (c, 2), *zip(fixed, range(4), strict=True)]:
        packing.put(item, place)
    before = dict(packing.at)
    assert place_item(packing, an_item("big", 0.5, 0)) is found
    moved = {name: place for name, place in packing.at.items() if before.get(name) != place}
    assert moved == ({"a": 1, "b": 2, "c": 3, "big": 0} if found else {})
    assert all(row[0] >= 0.0 for row in packing.free)


def test_a_task_at_an_overloaded_place_is_not_dropped_for_another() -> None:
    # Left is above what the place has, where relief of an overload has put it; new is not heavier than what is
    # free without left, and left fits nowhere any more.
    left, new = an_item("left", 1.25, 0), an_item("new", 0.5, 0)
    packing = Packing(free=[[1.0]], items={}, at={}, home={}, on=[[]], work=10_000)
    packing.put(left, 0)
    assert not place_item(packing, new)
    assert packing.at == {"left": 0}
    assert packing.free == [[-0.25]]
