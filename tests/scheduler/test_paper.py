# SPDX-License-Identifier: Apache-2.0
"""The paper's two scenarios in every weight variant: the shipped files, every number checked against a naive
computation.
"""

from pathlib import Path

import pytest

import edgectl
from edgectl.config.load import load_inventory_and_tasks
from edgectl.model.assignment import Assignment, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.policy import WEIGHT_PRESETS, Policy
from edgectl.model.task import Tasks
from tests.scheduler.fleets import decisions_by_task, hosts_by_task, list_terms, ranking_by_host, run_assign
from tests.scheduler.paper import BASE, ROBOTS, compute_naively, paper_snapshot

ROOT = Path(edgectl.__file__).parent.parent
NEEDS = {f"navigation-{robot}": f"slam-{robot}" for robot in ROBOTS}
ONBOARD = {f"slam-{robot}": robot for robot in ROBOTS} | {"map-merge": "robot1"}
STATIC = {"slam-robot1": "edge1", "slam-robot2": "edge2", "slam-robot3": "edge3", "map-merge": "edge1"}
# Edge numbers of detection 1-3, then navigation 1-3.
EXPECTED = {
    (1, "cpu"): "231 231", (1, "memory"): "231 321", (1, "network"): "231 322", (1, "task"): "231 322", (1, "all"): "231 322",
    (1, "resources"): "231 322",
    (2, "cpu"): "231 232", (2, "memory"): "231 322", (2, "network"): "231 322", (2, "task"): "231 123", (2, "all"): "231 123",
    (2, "resources"): "231 322",
}  # fmt: skip


def load_scenario(number: int) -> tuple[Inventory, Tasks]:
    inventory, tasks, _ = load_inventory_and_tasks(
        ROOT / "inventories/paper.yaml", [ROOT / f"tasks/paper-scenario-{number}.yaml"]
    )
    return inventory, tasks


def assign_scenario(number: int, variant: str) -> Assignment:
    inventory, tasks = load_scenario(number)
    # scenario 1 starts from nothing; in scenario 2 mapping and merging run on the edges
    return run_assign(
        inventory,
        tasks,
        paper_snapshot({} if number == 1 else STATIC),
        policy=Policy(weights=WEIGHT_PRESETS[variant]),
    )


@pytest.mark.parametrize(("number", "variant"), EXPECTED)
def test_every_number(number: int, variant: str) -> None:
    found = decisions_by_task(assign_scenario(number, variant))
    order = [name for name in found if name.startswith(("detection", "navigation"))]
    where, numbers = compute_naively(
        ONBOARD if number == 1 else STATIC, order, WEIGHT_PRESETS[variant], NEEDS
    )
    for name in order:
        assert found[name].host == where[name]
        assert found[name].total == pytest.approx(numbers[name][where[name]][4])
        for edge in BASE:
            assert list_terms(ranking_by_host(found[name])[edge]) == pytest.approx(numbers[name][edge])
            assert ranking_by_host(found[name])[edge].feasible == (min(numbers[name][edge][:3]) >= 0)


@pytest.mark.parametrize(("number", "variant"), EXPECTED)
def test_where_everything_goes(number: int, variant: str) -> None:
    made = assign_scenario(number, variant)
    found = hosts_by_task(made)
    edges = [
        "".join(str(found[f"{kind}-{robot}"])[-1] for robot in ROBOTS) for kind in ("detection", "navigation")
    ]
    assert " ".join(edges) == EXPECTED[number, variant]
    assert made.settled
    assert not any(decision.verdict is Verdict.UNPLACED for decision in made.decisions)
    assert {name: found[name] for name in STATIC} == (ONBOARD if number == 1 else STATIC)


def test_one_row_by_hand() -> None:
    # Scenario 2, variant all, detection-robot1 comes first. Percent of an edge; CPU counts to 120.
    # edge1: base 12 + slam 35.195 + merge 9.607 = 56.802;  cpu (120 - 56.802 - 60.035) / 120 = .026358
    #        memory (100 - 35 - 2.5 - 2.83 - 20.04) / 100 = .3963;  link (100 - 3 - 2.53 - 3.62 - 35.652) / 100 = .55198
    # edge2: cpu (120 - 10 - 35.195 - 60.035) / 120 = .123083;  memory (100 - 37.5 - 20.04) / 100 = .4246;  link (97 - 35.652) / 100 = .61348
    # edge3: cpu (120 - 11 - 35.195 - 60.035) / 120 = .114750;  the rest as edge2
    first = ranking_by_host(decisions_by_task(assign_scenario(2, "all"))["detection-robot1"])
    assert list_terms(first["edge1"])[:3] == pytest.approx((0.0263583, 0.3963, 0.55198), abs=1e-6)
    assert list_terms(first["edge2"]) == pytest.approx((0.1230833, 0.4246, 0.61348, 0.5, 0.4152908), abs=1e-6)
    assert list_terms(first["edge3"]) == pytest.approx((0.11475, 0.4246, 0.61348, 0.5, 0.4132075), abs=1e-6)
    # navigation-robot1 follows its slam to edge1 although edge3 is emptier: UT_task 1 against 0
    row = ranking_by_host(decisions_by_task(assign_scenario(2, "all"))["navigation-robot1"])
    assert [row[edge].terms["task"] for edge in BASE] == [1.0, 0.0, 0.0]
