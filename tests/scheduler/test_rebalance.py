# SPDX-License-Identifier: Apache-2.0
"""Rebalancing: the sum of utilities, computed here from the plan's expected loads, never falls."""

from dataclasses import replace

from edgectl.executor.diff import diff_assignment
from edgectl.model.assignment import Assignment, Reason, Verdict
from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from tests.scheduler.fleets import NO_MEMORY, hosts_by_task, simulate_apply
from tests.scheduler.tight_fleets import TightFleet, build_random_fleet, count_unplaced

PLAIN, REBALANCED = Policy(), Policy(rebalance=True)


def sum_utilities(fleet: TightFleet, found: Assignment) -> float:
    """Sum of eq. (4) of all placed tasks, which have no predecessors, at the loads after the plan."""
    total = 0.0
    for decision in found.decisions:
        if decision.host is None:
            continue
        sample, load = fleet.snapshot.hosts[decision.host], found.expected[decision.host]
        terms = [1 - load.used[name] / usage.capacity for name, usage in sample.usage.items()]
        robots = fleet.tasks.tasks[decision.task].robots
        terms.append(
            min(1 - load.links[robot] / sample.links[robot].capacity_bytes_per_s for robot in robots)
        )
        total += (sum(terms) + 0.5) / 4
    return total


def test_the_sum_rises_and_nobody_loses_a_place() -> None:
    gains = []
    for seed in range(5):
        fleet = build_random_fleet(5, 20, seed, 0.7)
        plain, found = (replace(fleet, policy=policy).assign() for policy in (PLAIN, REBALANCED))
        before, after = sum_utilities(fleet, plain), sum_utilities(fleet, found)
        assert count_unplaced(found) == count_unplaced(plain)
        assert after >= before - 1e-9
        assert not any(decision.overcommitted for decision in found.decisions)
        gains.append(after / before - 1)
    assert sum(gains) / len(gains) > 0.04


def test_a_rebalanced_plan_stands() -> None:
    for seed in range(4):
        fleet = replace(build_random_fleet(5, 20, seed, 0.7), policy=REBALANCED)
        first = fleet.assign()
        snapshot, memory = simulate_apply(first, fleet.tasks, fleet.snapshot, NO_MEMORY)
        again = replace(
            fleet, snapshot=snapshot, memory=memory, policy=replace(PLAIN, min_dwell=0.0)
        ).assign()
        steps = diff_assignment(again, fleet.tasks, snapshot, memory)
        assert {step.action for step in steps} <= {Action.KEEP, Action.UNPLACED}
        assert hosts_by_task(again) == hosts_by_task(first)


def test_running_tasks_move_only_for_more_than_the_margin() -> None:
    for seed in range(4):
        fleet = build_random_fleet(4, 12, seed, 0.6)
        first = fleet.assign()
        snapshot, memory = simulate_apply(first, fleet.tasks, fleet.snapshot, NO_MEMORY)
        running = replace(fleet, snapshot=snapshot, memory=memory)
        found = replace(running, policy=replace(REBALANCED, min_dwell=0.0, move_margin=0.15)).assign()
        moves = [d for d in found.decisions if d.verdict is Verdict.PLACED]
        assert all(decision.reason is Reason.REBALANCED for decision in moves)
        assert sum_utilities(fleet, found) >= sum_utilities(fleet, first) + 0.15 * len(moves) - 1e-9
        dwelling = replace(running, policy=replace(REBALANCED, min_dwell=120.0)).assign()
        assert hosts_by_task(dwelling) == hosts_by_task(first)
