# SPDX-License-Identifier: Apache-2.0
"""The best plan and the rebalanced one under rules between tasks: none is broken, and every bound is true."""

from dataclasses import replace
from itertools import product
from random import Random

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edgectl.model.assignment import Assignment, Reason
from edgectl.model.manager_state import Pin
from edgectl.model.policy import Policy, Preference
from edgectl.model.resource import Usage
from edgectl.model.snapshot import TaskState
from edgectl.model.task import Need
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
    policy = replace(fleet.policy, rebalance=way == "rebalance", optimal=way == "optimal")
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
    fleet = replace(fleet, policy=Policy(min_dwell=0.0, move_margin=0.0, prefer=prefer))
    if newcomers:
        fleet = run_some(fleet, newcomers)
    plain, found = fleet.assign(), improve(fleet, way)
    tasks = list(fleet.tasks.tasks.values())
    assume(not list_broken_rules(tasks, hosts_by_task(plain), 4))  # a task that runs may have no other host
    assert not list_broken_rules(tasks, hosts_by_task(found), 4)
    assert count_unplaced(found) <= count_unplaced(plain)


def add_group(fleet: TightFleet, seed: int) -> TightFleet:
    """``fleet`` with two of its tasks in a group."""
    tasks = dict(fleet.tasks.tasks)
    for name in Random(seed).sample(list(tasks), 2):
        tasks[name] = replace(tasks[name], group="g")
    return replace(fleet, tasks=replace(fleet.tasks, tasks=tasks))


@few
@given(seeds, st.floats(0.5, 1.1), st.sampled_from(Preference))
def test_the_plan_is_the_best_of_all_placements_that_keep_the_rules(
    seed: int, fill: float, prefer: Preference
) -> None:
    """Nothing is placed yet, so the whole search space is open; the certificate says what the search finds."""
    fleet = add_group(add_random_rules(build_random_fleet(3, 5, seed, fill), seed), seed)
    assume(is_consistent(fleet.tasks.tasks))
    certificate = get_certificate(optimise(replace(fleet, policy=Policy(prefer=prefer))))
    most, best = enumerate_by_rules(fleet, -1.0 if prefer is Preference.PACK else 1.0)
    assert certificate.placed <= most <= certificate.placed_bound
    assert not certificate.timed_out
    if certificate.placed == most:
        assert certificate.utility_sum <= best + 1e-9
        assert best <= (certificate.utility_sum_bound or 0.0) + 1e-6


def test_with_rules_the_best_plan_is_reached_and_proven() -> None:
    """The plan without the solver is not as good."""
    gains = []
    for seed in (1, 2, 4):
        fleet = add_group(add_random_rules(build_random_fleet(3, 5, seed, 0.7), seed), seed)
        assert is_consistent(fleet.tasks.tasks)
        found = get_certificate(optimise(fleet))
        most, best = enumerate_by_rules(fleet, 1.0)
        assert (found.placed, found.placed_bound) == (most, most)
        assert found.utility_sum == pytest.approx(best, rel=1e-6)
        assert found.utility_sum_bound == pytest.approx(best, rel=1e-6)
        assert "the highest (proven)" in found.describe()
        gains.append(best - (sum_placement(fleet, hosts_by_task(fleet.assign()), 1.0) or 0.0))
    assert max(gains) > 0.05


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
        whole = len({hosts[task.name] is None for task in tasks if task.group}) < 2
        if total is not None and whole and not list_broken_rules(tasks, hosts, len(fleet.snapshot.hosts)):
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


THREE = an_inventory(*map(an_edge, EDGES))


def test_it_proves_that_a_group_cannot_be_placed() -> None:
    """Three edges of 4 cores hold three tasks of 3 cores: no group of four."""
    tasks = some_tasks(*(a_task(f"g{n}", cpu=3.0, group="g") for n in range(4)), a_task("z", cpu=3.0))
    found = optimise(TightFleet(inventory=THREE, tasks=tasks, snapshot=IDLE))
    assert [name for name, host in hosts_by_task(found).items() if host] == ["z"]
    text = get_certificate(found).describe()
    assert text.startswith(
        "no placement of all 5 tasks exists (proven): 1 is placed, by priority as many as can be"
    )


def test_it_places_the_larger_group_of_which_the_plain_plan_starts_none() -> None:
    """Three edges of 4 cores hold three tasks of 3 cores. Placed one after the other the two of group a come first."""
    tasks = some_tasks(
        *(a_task(f"a{n}", cpu=3.0, group="a") for n in range(2)),
        *(a_task(f"b{n}", cpu=3.0, group="b") for n in range(3)),
    )
    fleet = TightFleet(inventory=THREE, tasks=tasks, snapshot=IDLE)
    placed = [name for name, host in hosts_by_task(fleet.assign()).items() if host]
    assert placed == ["a0", "a1"]
    found = optimise(fleet)
    assert [name for name, host in hosts_by_task(found).items() if host] == ["b0", "b1", "b2"]
    assert found.settled
    assert (
        get_certificate(found)
        .describe()
        .startswith("no placement of all 5 tasks exists (proven): 3 are placed")
    )
    reasons = {d.task: (d.reason, d.subject) for d in found.decisions if d.host is None}
    assert reasons == {"a0": (Reason.GROUP, "a1"), "a1": (Reason.GROUP, "a0")}


def test_a_group_that_waits_for_more_than_room_is_left_out_of_the_certificate() -> None:
    tasks = some_tasks(
        a_task("g0", group="g"),
        a_task("g1", group="g", needs=[Need(task="gone")]),
        a_task("z"),
        a_task("gone"),
    )
    snapshot = replace(
        IDLE,
        hosts={
            **IDLE.hosts,
            "edge1": a_sample(
                tasks={"gone": a_run(state=TaskState.FAILED, given_up=True, spec_hash="hash-gone")}
            ),
        },
    )
    found = optimise(TightFleet(inventory=THREE, tasks=tasks, snapshot=snapshot))
    assert [name for name, host in hosts_by_task(found).items() if host] == ["z"]
    assert get_certificate(found).describe().startswith("all 1 tasks are placed")
    assert get_certificate(found).describe().endswith("; without 1 task of an incomplete group")


def test_a_unit_is_one_handoff_of_max_moves() -> None:
    """edge1 runs a and b, which go together; big fits on edge1 alone and beside neither."""
    fleet = build_unit_that_must_leave()
    found = optimise(replace(fleet, policy=replace(fleet.policy, attended=False, max_moves=1)))
    assert hosts_by_task(found) == {"a": "edge2", "b": "edge2", "big": "edge1"}
    none = optimise(replace(fleet, policy=replace(fleet.policy, attended=False, max_moves=0)))
    assert hosts_by_task(none) == {"a": "edge1", "b": "edge1", "big": None}
    assert get_certificate(none).placed_bound == 2


def test_many_tasks_apart_from_many_are_bounded_as_they_are() -> None:
    """Ten copies of web are apart from ten of db, and those of solo from each other, on four edges of 4 cores."""
    edges = [f"edge{n}" for n in range(1, 5)]
    db = tuple(f"db{n}" for n in range(10))
    solo = tuple(f"solo{n}" for n in range(5))
    tasks = some_tasks(
        *(a_task(f"web{n}", template="web", cpu=0.1, apart=db) for n in range(10)),
        *(a_task(name, template="db", cpu=0.1) for name in db),
        *(a_task(name, template="solo", cpu=0.1, apart=tuple(x for x in solo if x != name)) for name in solo),
    )
    found = optimise(
        TightFleet(
            inventory=an_inventory(*map(an_edge, edges)),
            tasks=tasks,
            snapshot=a_snapshot({edge: a_sample() for edge in edges}),
        )
    )
    certificate = get_certificate(found)
    assert (certificate.placed, certificate.placed_bound) == (24, 24)
    assert "the highest (proven)" in certificate.describe()
    hosts = hosts_by_task(found)
    assert not {hosts[f"web{n}"] for n in range(10)} & {hosts[name] for name in db}


def test_rules_that_running_tasks_break_bound_nothing_falsely() -> None:
    """a and b run on edge1 and are apart since now, within their dwell; c is to be apart from both."""
    tasks = some_tasks(
        a_task("a", cpu=1.0, apart=("b", "c")), a_task("b", cpu=1.0, apart=("c",)), a_task("c", cpu=1.0)
    )
    runs = {name: a_run(used=Usage(cpu=1.0), spec_hash=f"hash-{name}", started_at=NOW - 5.0) for name in "ab"}
    snapshot = a_snapshot({"edge1": a_sample(used=2.0, tasks=runs), "edge2": a_sample(), "edge3": a_sample()})
    found = optimise(TightFleet(inventory=THREE, tasks=tasks, snapshot=snapshot))
    hosts = hosts_by_task(found)
    assert (hosts["a"], hosts["b"]) == ("edge1", "edge1")
    assert hosts["c"] in ("edge2", "edge3")
    assert "the highest (proven)" in get_certificate(found).describe()


def build_unit_that_must_leave() -> TightFleet:
    tasks = some_tasks(
        a_task("a", cpu=1.0, together=("b",)), a_task("b", cpu=1.0), a_task("big", cpu=4.0, only=["edge1"])
    )
    runs = {
        name: a_run(used=Usage(cpu=1.0), spec_hash=f"hash-{name}", started_at=NOW - 3600.0) for name in "ab"
    }
    return TightFleet(
        inventory=an_inventory(an_edge("edge1"), an_edge("edge2")),
        tasks=tasks,
        snapshot=a_snapshot({"edge1": a_sample(used=2.0, tasks=runs), "edge2": a_sample(used=0.5)}),
        policy=Policy(min_dwell=0.0, move_margin=0.9),
    )


def test_a_unit_that_must_make_room_is_no_limit_of_the_bounds() -> None:
    found = optimise(build_unit_that_must_leave())
    assert hosts_by_task(found) == {"a": "edge2", "b": "edge2", "big": "edge1"}
    certificate = get_certificate(found)
    assert (certificate.moves, certificate.moves_bound) == (2, 2)


@few
@given(seeds, st.floats(0.4, 0.9), st.integers(0, 3), st.sampled_from(["rebalance", "optimal"]))
def test_searches_leave_pinned_tasks_at_their_pins_and_break_no_rule_for_them(
    seed: int, fill: float, newcomers: int, way: str
) -> None:
    """Pins of operators on a third of the tasks; the plain plan says which of them can be followed now."""
    dice = Random(seed)
    fleet = add_random_rules(build_random_fleet(4, 12, seed, fill), seed)
    assume(is_consistent(fleet.tasks.tasks))
    fleet = replace(fleet, policy=Policy(min_dwell=0.0, move_margin=0.0))
    if newcomers:
        fleet = run_some(fleet, newcomers)
    hosts = sorted(fleet.inventory.hosts)
    pins = {
        name: Pin(host=dice.choice(hosts), since=NOW - 60.0 - turn)
        for turn, name in enumerate(dice.sample(sorted(fleet.tasks.tasks), 4))
    }
    fleet = replace(fleet, memory=replace(fleet.memory, pins=pins))
    plain, found = fleet.assign(), improve(fleet, way)
    tasks = list(fleet.tasks.tasks.values())
    assume(not list_broken_rules(tasks, hosts_by_task(plain), 4))
    assert not list_broken_rules(tasks, hosts_by_task(found), 4)
    assert count_unplaced(found) <= count_unplaced(plain)
    for before, after in zip(plain.decisions, found.decisions, strict=True):
        assert before.pin == after.pin, "a search decides no pin"
        if before.pin is not None and before.pin.set_aside is None and before.host == before.pin.host:
            assert after.host == before.host, before
