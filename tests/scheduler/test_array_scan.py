# SPDX-License-Identifier: Apache-2.0
"""The scan in NumPy against the one in Python: the same decisions and rankings, bit by bit."""

from random import Random

import pytest
from hypothesis import given, settings

from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Assignment
from edgectl.model.policy import Policy
from tests.benchmarks.planner import DIGESTS, add_measured_demand, build_fleet, digest_decisions
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
from tests.call_count import count_calls
from tests.scheduler.fleets import NO_MEMORY
from tests.scheduler.test_properties import Case, cases
from tests.scheduler.test_scan import a_view
from tests.scheduler.tight_fleets import TightFleet, build_full_fleet, build_random_fleet

build_array_scan = pytest.importorskip("edgectl.scheduler.array_scan").build_array_scan


def assign_with_arrays(case: Case | TightFleet) -> Assignment:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("edgectl.scheduler.assign.MIN_ARRAY_PAIRS", 0)
        return case.assign()


@given(case=cases())
@settings(max_examples=40, deadline=None)
def test_both_scans_decide_the_same(case: Case) -> None:
    assert assign_with_arrays(case) == case.assign()


@pytest.mark.parametrize(
    "fleet",
    [build_full_fleet(5, 20, seed=1), build_random_fleet(10, 40, 2, fill=0.9), build_random_fleet(70, 70, 3, fill=0.4)],
)  # fmt: skip
def test_both_scans_fill_a_fleet_in_the_same_way(fleet: TightFleet) -> None:
    assert assign_with_arrays(fleet) == fleet.assign()


@pytest.mark.parametrize("measured", [False, True])
def test_both_scans_decide_the_same_on_the_fleet_of_the_benchmark(measured: bool) -> None:
    inventory, tasks, snapshot = build_fleet(40, 120)
    memory = NO_MEMORY
    if measured:
        tasks, memory = add_measured_demand(tasks)
    fleet = TightFleet(inventory=inventory, tasks=tasks, snapshot=snapshot, memory=memory)
    plain, found = fleet.assign(), assign_with_arrays(fleet)
    assert found == plain
    # make bench checks those of 1,000 x 10,000.
    assert [digest_decisions(each) for each in (plain, found)] == [DIGESTS[40, 120, measured]] * 2


@pytest.mark.parametrize("measured", [False, True])
def test_a_large_plan_weighs_few_tasks_in_full(measured: bool) -> None:
    inventory, tasks, snapshot = build_fleet(20, 240)
    memory = NO_MEMORY
    if measured:
        tasks, memory = add_measured_demand(tasks)
    fleet = TightFleet(inventory=inventory, tasks=tasks, snapshot=snapshot, memory=memory)
    found = count_calls(lambda: assign_with_arrays(fleet))
    assert found["_start_task"] == 240
    assert found["weigh_candidates"] == 0, "ties are decided from arrays too"
    assert found["run_pass"] == 1, "bounds show that the repetition changes nothing"
    assert found["resolve_demand"] <= 24, "of nearly all tasks only numbers are asked for"


def build_fleet_of_ties(seed: int, weights: str, *, edges: int) -> TightFleet:
    """Edges of one or two kinds with names in reverse order of their places, and tasks of three kinds."""
    dice = Random(seed)
    sizes = [4.0, dice.choice([4.0, 8.0])]
    samples = {
        f"edge{edges - n}": a_sample(cores=sizes[n % 2], used=dice.choice([0.0, 0.0, 0.5]), links={robot: a_link() for robot in ("robot1", "robot2")})
        for n in range(edges)
    }  # fmt: skip
    tasks = [
        a_task(f"task{n}", cpu=dice.choice([0.0, 0.1, 0.2]), memory=dice.choice([0.0, GI / 8]), throughput=dice.choice([0.0, 1e5]),
               robots=dice.sample(["robot1", "robot2"], dice.randint(0, 2)),
               needs=[f"task{other}" for other in dice.sample(range(n), min(n, dice.choice([0, 0, 1, 2])))])
        for n in range(edges * 2)
    ]  # fmt: skip
    return TightFleet(
        inventory=an_inventory(*map(an_edge, samples), a_robot("robot1"), a_robot("robot2")),
        tasks=some_tasks(*tasks),
        snapshot=a_snapshot(samples),
        memory=NO_MEMORY,
        policy=Policy(weights=parse_weights(weights)),
    )


@pytest.mark.parametrize("weights", ["all", "cpu", "resources", "cpu=.5,memory=.2,task=.3"])
@pytest.mark.parametrize("edges", [6, 17, 66])
def test_ties_are_decided_the_same_from_arrays(edges: int, weights: str) -> None:
    seeds = range(2 if edges > 64 else 5)
    fleets = [build_fleet_of_ties(seed, weights, edges=edges) for seed in seeds]
    for fleet in fleets:
        assert assign_with_arrays(fleet) == fleet.assign()


@pytest.mark.parametrize("seed", range(80))
def test_both_scans_find_the_same_totals(seed: int) -> None:
    view = a_view(seed)
    context, ledger = view.context, view.ledger.copy()
    scan = build_array_scan(context.fleet, context.policy.weights, [view.task.name])
    scan.mirror(ledger)
    far = context.policy.weights["task"] * view.utilities.get(-len(view.located), 0.0)
    totals = list(scan.compute_totals(ledger.mirror, view.task, offset=far))
    alone = [place for place in view.listed if place not in view.denied and place not in view.located]
    assert [totals[place] for place in alone] == [view.totals[place] for place in alone]
