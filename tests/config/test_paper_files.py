# SPDX-License-Identifier: Apache-2.0
"""The paper's scenarios as shipped: ten tasks with the demands of its configuration, no warnings."""

from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import InputError
from edgectl.model.demand import Quantity
from edgectl.model.task import Need, OnboardRule

ROOT = Path(__file__).parents[2]
DEMANDS = {
    "slam": (35.195, 2.5, 2.53),
    "navigation": (2.705, 2.33, 2.328),
    "detection": (60.035, 20.04, 35.652),
    "map-merge": (9.607, 2.83, 3.62),
}
ROBOTS = ("robot1", "robot2", "robot3")


@pytest.mark.parametrize("scenario", [1, 2])
def test_scenarios_are_the_papers(scenario: int) -> None:
    inventory, tasks, warnings = load_inventory_and_tasks(
        ROOT / "inventories/paper.yaml", ROOT / f"tasks/paper-scenario-{scenario}.yaml"
    )
    assert not warnings
    assert [host.name for host in inventory.edges] == ["edge1", "edge2", "edge3"]
    assert [host.name for host in inventory.robots] == list(ROBOTS)
    assert {host.limits["cpu"] for host in inventory.edges} == {1.2}
    assert set(inventory.links.values()) == {6.75e6}
    assert len(inventory.links) == 9
    assert list(tasks.tasks) == [
        *(f"detection-{robot}" for robot in ROBOTS), "map-merge", *(f"navigation-{robot}" for robot in ROBOTS), *(f"slam-{robot}" for robot in ROBOTS)
    ]  # fmt: skip
    for task in tasks.tasks.values():
        demand = (task.demand["cpu"], task.demand["memory"], task.demand["network"])
        assert demand == tuple(
            Quantity(value=percent / 100, relative=True) for percent in DEMANDS[task.template]
        )
    asked = sum(task.demand["cpu"].value for task in tasks.tasks.values() if task.demand["cpu"] is not None)
    assert asked == pytest.approx(3.03412)
    for robot in ROBOTS:
        assert tasks.tasks[f"navigation-{robot}"].needs == (Need(task=f"slam-{robot}"),)
        assert tasks.tasks[f"detection-{robot}"].needs == ()
    assert [need.task for need in tasks.tasks["map-merge"].needs] == [f"slam-{robot}" for robot in ROBOTS]


def test_scenario_1_maps_on_board_and_scenario_2_finds_what_runs() -> None:
    first, second = (
        load_inventory_and_tasks(
            ROOT / "inventories/paper.yaml", ROOT / f"tasks/paper-scenario-{scenario}.yaml"
        )[1].tasks
        for scenario in (1, 2)
    )
    for name in ("slam-robot1", "map-merge"):
        assert (first[name].onboard, first[name].managed) == (OnboardRule.ONLY, True)
        assert (second[name].managed, second[name].detect is not None) == (False, True)
    for name in ("detection-robot1", "navigation-robot1"):
        assert {tasks[name].onboard for tasks in (first, second)} == {OnboardRule.NEVER}
        assert all(tasks[name].managed for tasks in (first, second))


def test_two_scenarios_at_once_are_refused_by_name() -> None:
    with pytest.raises(InputError) as caught:
        load_inventory_and_tasks(
            ROOT / "inventories/paper.yaml",
            [ROOT / "tasks/paper-scenario-1.yaml", ROOT / "tasks/paper-scenario-2.yaml"],
        )
    assert {problem.code for problem in caught.value.problems} == {"EC032"}
