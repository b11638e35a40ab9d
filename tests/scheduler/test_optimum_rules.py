"""The best plan and the rebalanced one under rules between tasks: none is broken, and every bound is true."""

from dataclasses import replace
from itertools import product

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edgectl.model.assignment import Assignment
from edgectl.model.policy import Policy, Preference
from edgectl.model.resource import Usage
from edgectl.scheduler.assign import assign
from edgectl.solver.highs import make_solver
from tests.builders import NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.scheduler.fleets import hosts_by_task, simulate_apply
from tests.scheduler.test_optimum import get_certificate, get_demand, optimise
from tests.scheduler.test_placement_rules import add_random_rules, is_consistent, list_broken_rules
from tests.scheduler.tight_fleets import TightFleet, build_random_fleet, count_unplaced

few = settings(max_examples=max(8, settings().max_examples // 10))
seeds = st.integers(0, 10_000)
PACK = Policy(prefer=Preference.PACK)


def run_some(fleet: TightFleet, newcomers: int) -> TightFleet:
    """``fleet`` in which all tasks but the last ``newcomers`` run, by its rules."""
    names = list(fleet.tasks.tasks)[: len(fleet.tasks.tasks) - newcomers]
    tasks = {
        name: replace(task, apart=_keep(task.apart, names), together=_keep(task.together, names))
        for name in names
        for task in [fleet.tasks.tasks[name]]
    }
    first = replace(fleet, tasks=replace(fleet.tasks, tasks=tasks))
    snapshot, memory = simulate_apply(first.assign(), first.tasks, fleet.snapshot, fleet.memory)
    return replace(fleet, snapshot=snapshot, memory=memory)


def _keep(others: tuple[str, ...], names: list[str]) -> tuple[str, ...]:
    return tuple(other for other in others if other in names)


def improve(fleet: TightFleet, way: str) -> Assignment:
    policy = replace(fleet.policy, rebalance=way == "rebalance", optimal=way == "optimal", move_margin=0.0)
    solve = make_solver(0.1) if policy.optimal else None
    return assign(fleet.inventory, fleet.tasks, fleet.snapshot, fleet.memory, policy, NOW, solve)


@few
@given(
    seeds,
    st.floats(0.5, 0.9),
    st.integers(0, 3),
    st.sampled_from(Preference),
    st.sampled_from(["rebalance", "optimal"]),
)
def test_no_rule_is_broken_and_no_task_loses_its_place(
    seed: int, fill: float, newcomers: int, prefer: Preference, way: str
) -> None:
    fleet = add_random_rules(build_random_fleet(4, 12, seed, fill), seed)
    assume(is_consistent(fleet.tasks.tasks))
    fleet = replace(fleet, policy=Policy(min_dwell=0.0, prefer=prefer))
    if newcomers:
        fleet = run_some(fleet, newcomers)
    plain, found = fleet.assign(), improve(fleet, way)
    tasks = list(fleet.tasks.tasks.values())
    assume(not list_broken_rules(tasks, hosts_by_task(plain), 4))  # a task that runs may have no other host
    assert not list_broken_rules(tasks, hosts_by_task(found), 4)
    assert count_unplaced(found) <= count_unplaced(plain)


@pytest.mark.parametrize("prefer", Preference)
def test_every_bound_holds_for_every_placement_that_keeps_the_rules(prefer: Preference) -> None:
    placed = 0
    for seed in range(4):
        fleet = add_random_rules(build_random_fleet(3, 5, seed, 0.6), seed)
        if not is_consistent(fleet.tasks.tasks):
            continue
        found = optimise(replace(fleet, policy=Policy(prefer=prefer)))
        most, best = enumerate_by_rules(fleet, -1.0 if prefer is Preference.PACK else 1.0)
        certificate = get_certificate(found)
        assert certificate.relaxed
        assert certificate.placed <= most <= certificate.placed_bound
        if certificate.placed == most:
            placed += 1
            assert certificate.utility_sum <= best + 1e-9
            assert best <= (certificate.utility_sum_bound or 0.0) + 1e-6
    assert placed > 1


def test_packing_reaches_the_best_of_all_placements() -> None:
    for seed in range(2):
        fleet = build_random_fleet(3, 5, seed, 0.7)
        certificate = get_certificate(optimise(replace(fleet, policy=PACK)))
        _, best = enumerate_by_rules(fleet, -1.0)
        assert certificate.utility_sum == pytest.approx(best, rel=1e-6)
        assert certificate.utility_sum_bound == pytest.approx(best, rel=1e-6)


def enumerate_by_rules(fleet: TightFleet, sign: float) -> tuple[int, float]:
    """The most tasks that have a place in a placement that fits and keeps the rules, and of those that place so
    many the greatest sum of utilities; tasks have one robot and no predecessors.
    """
    tasks = list(fleet.tasks.tasks.values())
    found = [(0, 0.0)]
    for places in product([None, *fleet.snapshot.hosts], repeat=len(tasks)):
        count = len(places) - places.count(None)
        if count < found[-1][0]:
            continue
        hosts = {task.name: place for task, place in zip(tasks, places, strict=True)}
        total = sum_placement(fleet, hosts, sign)
        if total is not None and not list_broken_rules(tasks, hosts, len(fleet.snapshot.hosts)):
            found.append(max((count, total), found[-1]))
    return found[-1]


def sum_placement(fleet: TightFleet, hosts: dict[str, str | None], sign: float) -> float | None:
    """The sum of utilities, None where the tasks do not fit. ``sign``: of the terms of resources."""
    total = 0.0
    for host, sample in fleet.snapshot.hosts.items():
        here = [task for name, task in fleet.tasks.tasks.items() if hosts[name] == host]
        free = [
            1 - (usage.used + sum(get_demand(task, name) for task in here)) / usage.capacity
            for name, usage in sample.usage.items()
        ]
        for task in here:
            (robot,) = task.robots
            link = sample.links[robot]
            rate = sum(get_demand(each, "network") for each in here if robot in each.robots)
            terms = [*free, 1 - (link.used_bytes_per_s + rate) / link.capacity_bytes_per_s]
            if min(terms) < -1e-9:
                return None
            total += (sign * sum(terms) + 0.5) / 4
    return total


EDGES = ["edge1", "edge2", "edge3"]
IDLE = a_snapshot({edge: a_sample() for edge in EDGES})


def test_tasks_of_incomplete_groups_are_left_out_of_the_certificate() -> None:
    """Three edges of 4 cores hold three tasks of 3 cores: no group of four."""
    tasks = some_tasks(*(a_task(f"g{n}", cpu=3.0, group="g") for n in range(4)), a_task("z", cpu=3.0))
    found = optimise(TightFleet(inventory=an_inventory(*map(an_edge, EDGES)), tasks=tasks, snapshot=IDLE))
    assert [name for name, host in hosts_by_task(found).items() if host] == ["z"]
    text = get_certificate(found).describe()
    assert text.startswith("all 1 tasks are placed; sum of utilities ")
    assert text.endswith(
        "; without 4 tasks of incomplete groups; all bounds are without the rules between tasks"
    )


def test_a_unit_that_must_make_room_is_no_limit_of_the_bounds() -> None:
    """edge1 runs a and b, which go together; big fits on edge1 alone and beside neither."""
    tasks = some_tasks(
        a_task("a", cpu=1.0, together=("b",)), a_task("b", cpu=1.0), a_task("big", cpu=4.0, only=["edge1"])
    )
    runs = {
        name: a_run(used=Usage(cpu=1.0), spec_hash=f"hash-{name}", started_at=NOW - 3600.0) for name in "ab"
    }
    snapshot = a_snapshot({"edge1": a_sample(used=2.0, tasks=runs), "edge2": a_sample(used=0.5)})
    fleet = TightFleet(
        inventory=an_inventory(an_edge("edge1"), an_edge("edge2")),
        tasks=tasks,
        snapshot=snapshot,
        policy=Policy(min_dwell=0.0, move_margin=0.9),
    )
    found = optimise(fleet)
    assert hosts_by_task(found) == {"a": "edge2", "b": "edge2", "big": "edge1"}
    certificate = get_certificate(found)
    assert (certificate.moves, certificate.moves_bound) == (2, 2)
