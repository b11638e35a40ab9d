# SPDX-License-Identifier: Apache-2.0
"""Results of the simulator, held by digests: what only makes it faster changes none of them.

``python -m tests.experiments.test_simulator_digests`` prints the table, for a change that is meant to change it.
"""

import hashlib
import random
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.weights import parse_weights
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.scenario import Radio, SimRun
from edgectl.experiments.model.schemes import build_schemes
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.policy import PolicyName

SCENARIOS = Path(__file__).parents[2] / "docs" / "scenarios"
POLICIES = (PolicyName.LOCAL, PolicyName.STATIC, PolicyName.UTILITY, PolicyName.PAPER)
RUNS = 2
DIGESTS = {
    "paper-1": {
        "local": "2de6ea8c4f96",
        "static": "71363d320e52",
        "utility all": "4777c55b7d65",
        "paper all": "2c1954ba6d99",
    },
    "paper-2": {
        "local": "51e4ca5fe399",
        "static": "2ad883b07961",
        "utility all": "473dd5c7bdf0",
        "paper all": "a946edd8b2ed",
    },
    "changing-links": {
        "local": "f0050c6a93fe",
        "static": "d33c81aef73e",
        "utility all": "178074cfc28b",
        "paper all": "1bccd96c79ea",
    },
    "changing-links, shared": {
        "local": "f0050c6a93fe",
        "static": "97b1ed603f26",
        "utility all": "77e0415ce2a4",
        "paper all": "67614fe10b85",
    },
    "patrol": {
        "local": "e51a5c46c0b1",
        "static": "6221e2529e34",
        "utility all": "4cb9975f566d",
        "paper all": "39354d9f93a1",
    },
}


def digest_scenario(name: str) -> Iterator[tuple[str, str]]:
    """The digest of the runs of each scheme, to nine digits."""
    file, _, radio = name.partition(", ")
    path = SCENARIOS / f"{file}.yaml"
    inventory_file, tasks_file = load_scenario_paths(path)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, tasks_file)
    scenario = load_scenario(path, inventory, tasks)
    scenario = replace(scenario, radio=Radio(radio)) if radio else scenario
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
    """Every number of a run."""
    numbers = [run.latency, *(run.jobs[job] for job in sorted(run.jobs))]
    for host in sorted(run.usage):
        used = run.usage[host]
        numbers += [used.cpu, used.cpu_peak, used.memory, used.network_bytes_per_s, used.rate or 0.0]
    return f"{run.finished} {run.handoffs} {run.unplaced} {[f'{number:.9g}' for number in numbers]}\n"


@pytest.mark.parametrize("name", DIGESTS)
def test_no_result_changed(name: str) -> None:
    assert dict(digest_scenario(name)) == DIGESTS[name]


if __name__ == "__main__":
    for each in DIGESTS:
        print(f'    "{each}": {dict(digest_scenario(each))},')
