# SPDX-License-Identifier: Apache-2.0
"""Changes of an explanation in the whole plan: each is made, and planned again on both sides of it."""

from dataclasses import replace
from random import Random

import pytest

from edgectl.model.assignment import Assignment, Decision
from edgectl.model.explanation import Flip, TieRule
from edgectl.model.policy import Policy
from edgectl.scheduler.crossings import STEP, apply_change, check_flips
from edgectl.scheduler.explain import explain_decision, find_tie
from tests.builders import (
    GI,
    a_link,
    a_robot,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import NO_MEMORY, hosts_by_task
from tests.scheduler.tight_fleets import TightFleet

BESIDE = 4 * STEP
CHANGES = 3


def build_fleet(seed: int) -> TightFleet:
    """Three edges, two robots, six tasks, some of them with predecessors."""
    dice = Random(seed)
    edges = ["edge1", "edge2", "edge3"]
    tasks = [
        a_task(
            f"task{number}",
            cpu=dice.uniform(0.1, 0.8),
            memory=dice.uniform(0.1, 0.6) * GI,
            throughput=dice.uniform(0.0, 1e6),
            robots=[dice.choice(["robot1", "robot2"])],
            needs=[f"task{number - 1}"] if number % 3 == 2 else [],
        )
        for number in range(6)
    ]
    links = {robot: a_link(10e6, dice.uniform(0.0, 4e6)) for robot in ("robot1", "robot2")}
    return TightFleet(
        inventory=an_inventory(
            *map(an_edge, edges), *(a_robot(robot, probe=False) for robot in ("robot1", "robot2"))
        ),
        tasks=some_tasks(*tasks),
        snapshot=a_snapshot(
            {
                edge: a_sample(
                    cores=dice.choice([2.0, 4.0]),
                    used=dice.uniform(0.0, 1.0),
                    used_memory=dice.uniform(0.0, 2.0) * GI,
                    links=links,
                )
                for edge in edges
            },
            memory=NO_MEMORY,
        ),
    )


def list_claims(fleet: TightFleet, found: Assignment, decision: Decision) -> tuple[Flip, ...]:
    """The checked changes of one decision."""
    task = fleet.tasks.tasks[decision.task]
    plain = explain_decision(fleet.inventory, task, fleet.snapshot, decision, found.policy)
    return check_flips(
        fleet.inventory, fleet.tasks, fleet.snapshot, found.policy, task.name, plain.flips[:CHANGES]
    )


def plan_after(fleet: TightFleet, policy: Policy, flip: Flip, size: float) -> dict[str, str | None]:
    """The whole plan after a change."""
    snapshot, how = apply_change(fleet.snapshot, policy, flip, size)
    return hosts_by_task(replace(fleet, snapshot=snapshot, policy=how).assign())


@pytest.mark.parametrize("seed", range(3))
def test_every_claim_is_true_of_the_whole_plan(seed: int) -> None:
    fleet = build_fleet(seed)
    found = fleet.assign()
    base = hosts_by_task(found)
    claims = 0
    for decision in found.decisions[2::3]:
        for flip in list_claims(fleet, found, decision):
            assert flip.amount >= 0.0
            first = flip.first
            start = first.amount / flip.unit if first is not None and flip.host is not None else None
            after = plan_after(fleet, found.policy, flip, flip.size + BESIDE)
            before = plan_after(fleet, found.policy, flip, max(0.0, flip.size - BESIDE))
            assert after[decision.task] == flip.winner
            if first is None:
                assert before == base
            elif start is not None:
                moved = plan_after(fleet, found.policy, flip, start + BESIDE)
                assert (moved[first.task], moved[decision.task]) == (first.host, base[decision.task])
                assert plan_after(fleet, found.policy, flip, max(0.0, start - BESIDE)) == base
            assert before[decision.task] == base[decision.task]
            claims += 1
    assert claims >= 2


def test_another_task_that_moves_first_is_named() -> None:
    fleet = build_fleet(0)
    found = fleet.assign()
    claims = list_claims(fleet, found, found.decisions[5])
    movers = {flip.first.task for flip in claims if flip.first is not None}
    assert movers
    assert "task5" not in movers


def test_a_tie_says_what_decided() -> None:
    three = an_inventory(*map(an_edge, ["edge1", "edge2", "edge3"]))
    snapshot = a_snapshot(edge1=a_sample(), edge2=a_sample(), edge3=a_sample(used=1.0))
    found = TightFleet(
        inventory=three, tasks=some_tasks(a_task("a", cpu=0.0), a_task("b", cpu=0.0)), snapshot=snapshot
    ).assign()
    first, second = found.decisions
    one, other = find_tie(first, ()), find_tie(second, (first,))
    assert one is not None
    assert (one.hosts, one.rule) == (("edge2",), TieRule.NAMES)
    assert other is not None
    assert (second.host, other.hosts, other.rule) == ("edge2", ("edge1",), TieRule.FEWEST_TASKS)
