# SPDX-License-Identifier: Apache-2.0
"""Other names change nothing but ties: plain, rebalanced and optimal plans.

Names decide between hosts that are equal, and, as the order of the sequence, between tasks of equal priority.
"""

from collections.abc import Sequence
from dataclasses import replace
from random import Random

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from edgectl.model.assignment import Assignment, Certificate
from edgectl.model.demand import Demand
from edgectl.model.policy import Policy
from edgectl.names import natural_key
from edgectl.scheduler.assign import assign
from edgectl.scheduler.packing import Packing
from edgectl.scheduler.rebalance import rebalance_packing
from edgectl.scheduler.utility_sum import Objective
from edgectl.solver.highs import make_solver
from tests.builders import NOW
from tests.scheduler.fleets import NO_MEMORY, simulate_apply
from tests.scheduler.renaming import Names, list_renamed_hosts, rename_everywhere
from tests.scheduler.test_properties import Case, cases
from tests.scheduler.tight_fleets import TightFleet, build_random_fleet, count_unplaced

few = settings(max_examples=max(4, settings().max_examples // 12))
ways = st.sampled_from(["plain", "rebalance", "optimal"])
searches = st.sampled_from(["rebalance", "optimal"])


def decide(fleet: TightFleet, way: str) -> Assignment:
    policy = replace(fleet.policy, rebalance=way == "rebalance", optimal=way == "optimal")
    solve = make_solver(60.0) if policy.optimal else None
    return assign(fleet.inventory, fleet.tasks, fleet.snapshot, fleet.memory, policy, NOW, solve)


def get_certificate(found: Assignment) -> Certificate:
    assert found.certificate is not None
    return found.certificate


def shuffle_names(names: list[str], dice: Random) -> Names:
    """Names in another order than ``names``."""
    return dict(zip(names, dice.sample([f"n{number}" for number in range(30)], len(names)), strict=True))


def build_fleet(seed: int, *, runs: bool, ranked: bool, edges: int = 3) -> TightFleet:
    """``edges`` and three times as many tasks, of which no two are equal. ``runs``: all of them run, where the
    plan put them; ``ranked``: priorities order them.
    """
    fleet = build_random_fleet(edges, 3 * edges, seed, 0.7)
    tasks = {
        name: replace(task, priority=float(ranked * index), demand=_scale_cpu(task.demand, 1 + index / 1000))
        for index, (name, task) in enumerate(fleet.tasks.tasks.items())
    }
    fleet = replace(fleet, tasks=replace(fleet.tasks, tasks=tasks))
    if not runs:
        return fleet
    snapshot, memory = simulate_apply(fleet.assign(), fleet.tasks, fleet.snapshot, NO_MEMORY)
    policy = Policy(min_dwell=0.0, move_margin=0.02)
    return replace(fleet, snapshot=snapshot, memory=memory, policy=policy)


def _scale_cpu(demand: Demand, factor: float) -> Demand:
    cpu = demand["cpu"]
    assert cpu is not None
    return Demand({**demand, "cpu": replace(cpu, value=cpu.value * factor)})


@few
@given(cases(), ways)
def test_names_in_the_same_order_change_nothing_at_all(case: Case, way: str) -> None:
    fleet = TightFleet(
        inventory=case.inventory,
        tasks=case.tasks,
        snapshot=case.snapshot,
        memory=case.memory,
        policy=case.policy,
    )
    hosts, tasks = (sorted(each, key=natural_key) for each in (case.inventory.hosts, case.tasks.tasks))
    names = {host: f"h{number}" for number, host in enumerate(hosts)}
    names |= {task: f"t{number}" for number, task in enumerate(tasks)}
    plain, found = decide(fleet, way), decide(rename_everywhere(fleet, names), way)
    assert list_renamed_hosts(found, {}) == list_renamed_hosts(plain, names)
    for mine, other in zip(plain.decisions, found.decisions, strict=True):
        assert (mine.verdict, mine.reason, mine.total) == (other.verdict, other.reason, other.total)


@few
@given(st.integers(0, 10_000), st.booleans(), searches, st.randoms(use_true_random=False))
def test_other_names_of_hosts_and_robots_change_nothing(
    seed: int, runs: bool, way: str, dice: Random
) -> None:
    fleet = build_fleet(seed, runs=runs, ranked=False)
    check_names(fleet, shuffle_names(list(fleet.inventory.hosts), dice), way)


@few
@given(st.integers(0, 10_000), st.booleans(), searches, st.randoms(use_true_random=False))
def test_other_names_of_tasks_change_nothing_where_priorities_order_them(
    seed: int, runs: bool, way: str, dice: Random
) -> None:
    fleet = build_fleet(seed, runs=runs, ranked=True)
    check_names(fleet, shuffle_names(list(fleet.tasks.tasks), dice), way)


def check_names(fleet: TightFleet, names: Names, way: str) -> None:
    """The rebalanced plan has every task on the same host, the best one has the same value."""
    plain, found = decide(fleet, way), decide(rename_everywhere(fleet, names), way)
    if way == "rebalance":
        assert list_renamed_hosts(found, {}) == list_renamed_hosts(plain, names)
        return
    one, other = get_certificate(plain), get_certificate(found)
    assume(not one.timed_out and not other.timed_out)
    assert count_unplaced(found) == count_unplaced(plain)
    assert (one.placed, one.moves) == (other.placed, other.moves)
    assert one.utility_sum == pytest.approx(other.utility_sum, abs=1e-5)


@few
@given(st.integers(0, 10_000), st.randoms(use_true_random=False))
def test_the_search_for_a_balance_does_not_see_names(seed: int, dice: Random) -> None:
    """Of running tasks of one priority. What settles its plan takes them in the order of their names."""
    fleet = build_fleet(seed, runs=True, ranked=False, edges=5)
    names = shuffle_names([*fleet.tasks.tasks, *fleet.inventory.hosts], dice)
    both = fleet, rename_everywhere(fleet, names)
    if any(each.host != each.previous_host for one in both for each in decide(one, "plain").decisions):
        return  # a gain is taken in the order of names, too
    found: list[dict[str, Sequence[float]]] = []

    def rebalance(packing: Packing, objective: Objective, margin: float) -> None:
        rebalance_packing(packing, objective, margin)
        found.append({name: packing.free[place] for name, place in packing.at.items()})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edgectl.scheduler.rebalanced_plan.rebalance_packing", rebalance)
        for one in both:
            decide(one, "rebalance")
    plain, renamed = found
    for name, free in plain.items():
        # Columns of links are in the order of the robots' names.
        assert sorted(renamed[names[name]]) == pytest.approx(sorted(free))
