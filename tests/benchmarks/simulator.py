# SPDX-License-Identifier: Apache-2.0
"""Speed of the mission simulator in runs per CPU second: ``python -m tests.benchmarks.simulator [RUNS]``.

The runs of a scheme share what they have in common, and no garbage is looked for meanwhile, as in a sweep.
"""

import random
import sys
import time
from functools import partial
from pathlib import Path

from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.weights import parse_weights
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.schemes import build_schemes
from edgectl.experiments.simulator import simulate_mission
from edgectl.experiments.simulator_memory import SimMemory
from edgectl.model.policy import PolicyName
from edgectl.scheduler.garbage import pause_collection

SCENARIOS = Path(__file__).parents[2] / "docs" / "scenarios"
POLICIES = (PolicyName.LOCAL, PolicyName.STATIC, PolicyName.UTILITY, PolicyName.PAPER)


def main(runs: int = 20) -> None:
    """Print a row for each scenario and scheme."""
    print("| scenario | scheme | runs/s | ms per run | simulated min per s |\n|---|---|---|---|---|")
    for name in ("paper-1", "paper-2"):
        path = SCENARIOS / f"{name}.yaml"
        inventory_file, tasks_file = load_scenario_paths(path)
        assert inventory_file is not None
        assert tasks_file is not None
        inventory, tasks, _ = load_inventory_and_tasks(inventory_file, tasks_file)
        scenario = load_scenario(path, inventory, tasks)
        for variant in build_schemes(tasks.policy, POLICIES, {"all": parse_weights("all")}, []):
            began, minutes = time.process_time(), 0.0
            memory = SimMemory(inventory=inventory, tasks=tasks, scenario=scenario, policy=variant.policy)
            with pause_collection():
                for run in range(runs):
                    dice = partial(random.Random(run).gauss, 0.0, 1.0)
                    made = simulate_mission(inventory, tasks, scenario, variant.policy, dice, memory=memory)
                    minutes += made.latency / 60
            seconds = time.process_time() - began
            row = (
                name,
                variant.name,
                f"{runs / seconds:.1f}",
                f"{seconds / runs * 1000:.1f}",
                f"{minutes / seconds:.0f}",
            )
            print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
