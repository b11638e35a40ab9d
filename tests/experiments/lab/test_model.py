# SPDX-License-Identifier: Apache-2.0
"""The scenario of the shipped experiment has the numbers of its mission."""

from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.experiments.files.experiment_file import load_experiment, load_experiment_paths
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from tests.experiments.lab.mission import MISSION, ROOT, follower, world

SCENARIO = ROOT / "docs" / "scenarios" / "experiment.yaml"


def test_the_shipped_spec_is_good() -> None:
    inventory, tasks = load_experiment_paths(MISSION / "experiment.yaml")
    assert inventory is not None
    assert tasks is not None
    _, loaded, warnings = load_inventory_and_tasks(inventory, [tasks])
    spec = load_experiment(MISSION / "experiment.yaml", loaded)
    assert warnings == ()
    assert [variant.name for variant in spec.schemes] == [
        "local",
        "static",
        *(f"utility {w}" for w in ("cpu", "memory", "network", "all")),
    ]
    assert (MISSION / spec.maps["ssim"].truth).exists()


def test_the_models_inputs_are_the_missions_own() -> None:
    inventory_file, tasks_file = load_scenario_paths(SCENARIO)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, [Path(tasks_file)])
    scenario = load_scenario(SCENARIO, inventory, tasks)
    for name, host in scenario.hosts.items():
        capacity = inventory.hosts[name].capacity
        assert capacity is not None
        assert (host.cores, host.memory) == (capacity["cpu"], capacity["memory"])
    stops, command = len(world.Plan().tour(1, 2)), {name: task.command for name, task in tasks.tasks.items()}
    work = {job.name: job.work for job in scenario.jobs}
    assert "--rate 10" in command["detection-robot1"]
    assert "--rate 8" in command["mapper-robot1"]
    assert work["look-robot1"] == work["look-robot2"] == pytest.approx(stops * follower.FRAMES / 10)
    assert work["map-robot1"] == work["map-robot2"] == pytest.approx(stops * follower.SCANS / 8)
    assert set(scenario.rate.values()) == {10.0}
