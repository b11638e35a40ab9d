"""How many runs of the paper's missions the model makes per second of CPU: ``python -m tests.benchmarks.simulator [RUNS]``."""

import random
import sys
import time
from functools import partial
from pathlib import Path

from edgectl.config.load import load
from edgectl.config.scenario import load_scenario, scenario_files
from edgectl.evidence.simulate import simulate
from edgectl.model.policy import PolicyName
from edgectl.model.variants import variants

SCENARIOS = Path(__file__).parents[2] / "docs" / "scenarios"
POLICIES = (PolicyName.LOCAL, PolicyName.STATIC, PolicyName.UTILITY, PolicyName.PAPER)


def main(runs: int = 10) -> None:
    """Print a row for each scenario and scheme."""
    print("| scenario | scheme | runs/s | ms per run | simulated min per s |\n|---|---|---|---|---|")
    for name in ("paper-1", "paper-2"):
        path = SCENARIOS / f"{name}.yaml"
        inventory_file, tasks_file = scenario_files(path)
        assert inventory_file is not None
        assert tasks_file is not None
        inventory, tasks, _ = load(inventory_file, tasks_file)
        scenario = load_scenario(path, inventory, tasks)
        for variant in variants(tasks.policy, POLICIES, ["all"], []):
            began, minutes = time.process_time(), 0.0
            for run in range(runs):
                dice = partial(random.Random(run).gauss, 0.0, 1.0)
                minutes += simulate(inventory, tasks, scenario, variant.policy, dice).latency / 60
            seconds = time.process_time() - began
            row = (name, variant.name, f"{runs / seconds:.1f}", f"{seconds / runs * 1000:.1f}", f"{minutes / seconds:.0f}")
            print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
