# SPDX-License-Identifier: Apache-2.0
"""The best plan: as good as the best of all placements, each of its bounds true, and never worse than others."""

from dataclasses import replace
from itertools import product
from math import inf
from random import Random

import pytest

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Assignment, Certificate, Reason
from edgectl.model.demand import ZERO
from edgectl.model.manager_state import Placement
from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample
from edgectl.model.task import Task
from edgectl.scheduler.assign import assign
from edgectl.scheduler.integer_program import IntegerProgram, Solution
from edgectl.solver.highs import make_solver, solve_program
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import NO_MEMORY, decisions_by_task, hosts_by_task, simulate_apply
from tests.scheduler.test_rebalance import sum_utilities
from tests.scheduler.tight_fleets import TightFleet, build_full_fleet, build_random_fleet, count_unplaced

OPTIMAL, REBALANCED = Policy(optimal=True), Policy(rebalance=True)


def optimise(fleet: TightFleet, deadline_s: float = inf) -> Assignment:
    solve = make_solver(deadline_s)
    policy = replace(fleet.policy, optimal=True)
    return assign(fleet.inventory, fleet.tasks, fleet.snapshot, fleet.memory, policy, NOW, solve)


def get_certificate(found: Assignment) -> Certificate:
    assert found.certificate is not None
    return found.certificate


def run_first(fleet: TightFleet, newcomers: int) -> TightFleet:
    """``fleet`` in which all tasks but the first ``newcomers`` run."""
    names = sorted(fleet.tasks.tasks)[newcomers:]
    tasks = replace(fleet.tasks, tasks={name: fleet.tasks.tasks[name] for name in names})
    first = replace(fleet, tasks=tasks).assign()
    snapshot, memory = simulate_apply(first, tasks, fleet.snapshot, fleet.memory)
    return replace(fleet, snapshot=snapshot, memory=memory, policy=Policy(min_dwell=0.0))


def enumerate_sums(fleet: TightFleet) -> float:
    """The greatest sum of utilities of all placements that fit; tasks have one robot and no predecessors."""
    hosts = list(fleet.snapshot.hosts.values())
    tasks = list(fleet.tasks.tasks.values())
    best = 0.0
    for places in product(range(len(hosts)), repeat=len(tasks)):
        here = [
            [task for task, place in zip(tasks, places, strict=True) if place == each]
            for each in range(len(hosts))
        ]
        found = [sum_at_host(sample, group) for sample, group in zip(hosts, here, strict=True)]
        best = max(best, sum(found))
    return best


def sum_at_host(sample: HostSample, tasks: list[Task]) -> float:
    """The sum of utilities of ``tasks`` at one host, -inf where they do not fit."""
    free = [
        1 - (usage.used + sum(get_demand(task, name) for task in tasks)) / usage.capacity
        for name, usage in sample.usage.items()
    ]
    rates = {
        robot: sum(get_demand(task, "network") for task in tasks if robot in task.robots)
        for robot in sample.links
    }
    links = {
        robot: 1 - (link.used_bytes_per_s + rates[robot]) / link.capacity_bytes_per_s
        for robot, link in sample.links.items()
    }
    terms = [[*free, links[task.robots[0]]] for task in tasks]
    return sum((sum(each) + 0.5) / 4 if min(each) >= 0 else float("-inf") for each in terms)


def get_demand(task: Task, resource: str) -> float:
    return (task.demand[resource] or ZERO).value


def test_the_sum_is_the_best_of_all_placements() -> None:
    for seed in range(3):
        fleet = build_random_fleet(3, 6, seed, 0.75)
        found = optimise(fleet)
        certificate = get_certificate(found)
        assert count_unplaced(found) == 0
        assert certificate.utility_sum == pytest.approx(enumerate_sums(fleet), rel=1e-6)
        assert certificate.utility_sum == pytest.approx(sum_utilities(fleet, found), rel=1e-9)
        assert certificate.utility_sum_bound == pytest.approx(certificate.utility_sum, rel=1e-6)


def test_it_is_no_worse_than_the_rebalanced_plan_and_stands() -> None:
    fleet = build_random_fleet(5, 20, 4, 0.7)
    found = optimise(fleet)
    assert found.settled
    rebalanced = replace(fleet, policy=REBALANCED).assign()
    assert sum_utilities(fleet, found) >= sum_utilities(fleet, rebalanced) - 1e-6
    assert not any(decision.overcommitted for decision in found.decisions)
    assert (
        get_certificate(found).describe()
        == "all 20 tasks are placed; sum of utilities 9.171, the highest (proven)"
    )
    snapshot, memory = simulate_apply(found, fleet.tasks, fleet.snapshot, NO_MEMORY)
    later = replace(fleet, snapshot=snapshot, memory=memory, policy=Policy(min_dwell=0.0))
    for again in (later.assign(), optimise(later)):
        assert hosts_by_task(again) == hosts_by_task(found)
        steps = diff_assignment(again, fleet.tasks, snapshot, memory)
        assert {step.action for step in steps} == {Action.KEEP}
    assert optimise(fleet).decisions == found.decisions


TWO = an_inventory(an_edge("edge1"), an_edge("edge2"))


def test_it_proves_that_no_placement_of_all_exists() -> None:
    # Three tasks of 2.5 cores on two edges of 4: 7.5 of 8 cores, so the sum says nothing.
    tasks = some_tasks(*(a_task(name, cpu=2.5) for name in ("a", "b", "c")))
    fleet = TightFleet(
        inventory=TWO, tasks=tasks, snapshot=a_snapshot(edge1=a_sample(), edge2=a_sample()), policy=OPTIMAL
    )
    found = optimise(fleet)
    assert count_unplaced(found) == 1
    assert (
        get_certificate(found)
        .describe()
        .startswith(
            "no placement of all 3 tasks exists (proven): 2 are placed, by priority as many as can be; sum of"
        )
    )


def test_a_higher_priority_is_placed_before_two_of_lower() -> None:
    # big fits beside nothing on edge1; a and b take a place each if they come first.
    tasks = some_tasks(
        a_task("big", cpu=4.0, priority=1.0), a_task("a", cpu=2.5), a_task("b", cpu=2.5), a_task("c", cpu=1.0)
    )
    fleet = TightFleet(
        inventory=TWO, tasks=tasks, snapshot=a_snapshot(edge1=a_sample(), edge2=a_sample()), policy=OPTIMAL
    )
    found = optimise(fleet)
    assert decisions_by_task(found)["big"].host is not None
    assert get_certificate(found).placed == get_certificate(found).placed_bound == 3


def test_the_fewest_running_tasks_make_room() -> None:
    # edge1 runs a (1 core), b (1) and c (2): big (2, edge1 alone) needs 2 of its cores. One move of c is enough;
    # repair would move what it finds first.
    tasks = some_tasks(
        *(a_task(name, cpu=cpu) for name, cpu in (("a", 1.0), ("b", 1.0), ("c", 2.0))),
        a_task("big", cpu=2.0, only=["edge1"]),
    )
    runs = {
        name: a_run(used=Usage(cpu=cpu), spec_hash=f"hash-{name}", started_at=NOW - 3600.0)
        for name, cpu in (("a", 1.0), ("b", 1.0), ("c", 2.0))
    }
    memory = replace(
        NO_MEMORY, placements={name: Placement(host="edge1", since=NOW - 3600.0) for name in runs}
    )
    snapshot = a_snapshot(
        {"edge1": a_sample(used=4.0, tasks=runs), "edge2": a_sample(used=1.9)}, memory=memory
    )
    fleet = TightFleet(
        inventory=TWO, tasks=tasks, snapshot=snapshot, memory=memory, policy=Policy(move_margin=0.9)
    )
    found = optimise(fleet)
    assert hosts_by_task(found) == {"a": "edge1", "b": "edge1", "big": "edge1", "c": "edge2"}
    assert (
        get_certificate(found)
        .describe()
        .startswith("all 4 tasks are placed; 1 running task makes room, the fewest that can (proven)")
    )
    pinned = replace(
        tasks,
        tasks={
            **tasks.tasks,
            "c": replace(tasks.tasks["c"], hosts=replace(tasks.tasks["c"].hosts, pin="edge1")),
        },
    )
    assert get_certificate(optimise(replace(fleet, tasks=pinned))).moves == 2


def test_unattended_it_moves_no_more_than_max_moves() -> None:
    fleet = run_first(build_full_fleet(3, 8, 5, fill=(0.9, 0.96)), 4)
    policy = Policy(min_dwell=0.0, attended=False, max_moves=1, move_margin=1.0)
    found = optimise(replace(fleet, policy=policy))
    assert get_certificate(found).moves <= 1


def test_never_worse_and_every_bound_holds() -> None:
    dice, reasons = Random(3), set()
    for seed in range(8):
        fleet = run_first(build_full_fleet(3, 7, seed, fill=(0.85, 0.97)), dice.randrange(1, 5))
        found, plain = optimise(fleet), fleet.assign()
        certificate = get_certificate(found)
        reasons |= {decision.reason for decision in found.decisions}
        assert count_unplaced(found) <= count_unplaced(plain)
        # A full placement of the tasks exists by construction; of those that run, any may move.
        assert certificate.placed == certificate.wanted == certificate.placed_bound
        assert certificate.moves >= certificate.moves_bound
        assert certificate.utility_sum <= (certificate.utility_sum_bound or 9e9) + 1e-9
        if count_unplaced(found) == count_unplaced(plain):
            moved = [
                step
                for step in diff_assignment(plain, fleet.tasks, fleet.snapshot, fleet.memory)
                if step.action is Action.MOVE
            ]
            assert certificate.moves <= len(moved)
    assert Reason.OPTIMAL in reasons


def test_without_time_the_plan_is_the_plain_one_and_nothing_is_claimed() -> None:
    fleet = run_first(build_full_fleet(4, 12, 1), 4)
    found = optimise(fleet, deadline_s=0.0)
    certificate = get_certificate(found)
    assert count_unplaced(found) <= count_unplaced(fleet.assign())
    assert certificate.moves_bound == 0
    assert certificate.timed_out
    assert certificate.describe().endswith("; the time was up: another run may find another plan")
    assert "highest" not in certificate.describe() or "at most" in certificate.describe()


@pytest.mark.parametrize(
    ("upper", "values", "bound"), [(7.0, (1.0, 1.0, 0.0), 9.0), (-1.0, None, float("-inf"))]
)
def test_the_solver_finds_the_best_or_that_there_is_none(
    upper: float, values: tuple[float, ...] | None, bound: float
) -> None:
    program = IntegerProgram()
    variables = {program.add_variable(gain): weight for gain, weight in ((5.0, 4.0), (4.0, 3.0), (3.0, 2.0))}
    program.add_row(variables, upper=upper)
    program.add_row(dict.fromkeys(variables, 1.0), lower=0.0)
    assert solve_program(program, 10.0) == Solution(values=values, bound=bound)
