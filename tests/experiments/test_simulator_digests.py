# SPDX-License-Identifier: Apache-2.0
"""Results of the simulator, held by digests: what only makes it faster changes none of them.

``python -m tests.experiments.test_simulator_digests`` prints the table, for a change that is meant to change it.
"""

import hashlib
import random
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.weights import parse_weights
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.scenario import SimRun
from edgectl.experiments.model.schemes import build_schemes
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.policy import PolicyName

SCENARIOS = Path(__file__).parents[2] / "docs" / "scenarios"
POLICIES = (PolicyName.LOCAL, PolicyName.STATIC, PolicyName.UTILITY, PolicyName.PAPER)
RUNS = 2
DIGESTS = {
    "paper-1": {
        "local": "3efe0a4f8525",
        "static": "12f146abb98e",
        "utility all": "fa1347d6b255",
        "paper all": "b6f16b5f83a2",
    },
    "paper-2": {
        "local": "a93c4bb736f0",
        "static": "dc411ba7b93b",
        "utility all": "43d9c18fe004",
        "paper all": "b0b27326488d",
    },
    "changing-links": {
        "local": "f4ad444c2f17",
        "static": "36ad57fe581d",
        "utility all": "c6d6f69c3974",
        "paper all": "7d6443112b2f",
    },
    "patrol": {
        "local": "ec51fa5347f5",
        "static": "0543f711e7bb",
        "utility all": "0543f711e7bb",
        "paper all": "db3f67f2e513",
    },
}


def digest_scenario(name: str) -> Iterator[tuple[str, str]]:
    """The digest of the runs of each scheme, to nine digits."""
    path = SCENARIOS / f"{name}.yaml"
    inventory_file, tasks_file = load_scenario_paths(path)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, tasks_file)
    scenario = load_scenario(path, inventory, tasks)
    for scheme in build_schemes(tasks.policy, POLICIES, {"all": parse_weights("all")}, []):
        sums = hashlib.sha256()
        endless = (
            scheme.policy.name is PolicyName.PAPER and name == "paper-1"
        )  # never finishes: 284 plans a run
        for run in range(1 if endless else RUNS):
            dice = partial(random.Random(f"7/{run}").gauss, 0.0, 1.0)
            sums.update(
                describe_run(simulate_mission(inventory, tasks, scenario, scheme.policy, dice)).encode()
            )
        yield scheme.name, sums.hexdigest()[:12]


def describe_run(run: SimRun) -> str:
    """Every number of a run but frames, which are a factor of the speed."""
    numbers = [run.latency, *(run.jobs[job] for job in sorted(run.jobs))]
    for host in sorted(run.usage):
        used = run.usage[host]
        numbers += [used.cpu, used.cpu_peak, used.memory, used.network_bytes_per_s]
    return f"{run.finished} {run.handoffs} {run.unplaced} {[f'{number:.9g}' for number in numbers]}\n"


@pytest.mark.parametrize("name", DIGESTS)
def test_no_result_changed(name: str) -> None:
    assert dict(digest_scenario(name)) == DIGESTS[name]


if __name__ == "__main__":
    for each in DIGESTS:
        print(f'    "{each}": {dict(digest_scenario(each))},')
