# SPDX-License-Identifier: Apache-2.0
"""Runs that share what they have in common: each is the one that it is alone."""

import random
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import simpy

from edgectl.config.load import load_inventory_and_tasks
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.scenario import Radio, Scenario, SimRun
from edgectl.experiments.simulator import simulate_mission
from edgectl.experiments.simulator_memory import KnownShares, SimMemory, SimSample
from edgectl.experiments.simulator_probe import simulate_probe
from edgectl.experiments.simulator_speeds import update_speeds
from edgectl.experiments.simulator_state import HostMeter, SimState, SimTask
from edgectl.model.inventory import Inventory
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import Tasks
from tests.experiments.test_simulator_digests import describe_run

SCENARIOS = Path(__file__).parents[2] / "docs" / "scenarios"


def load(name: str) -> tuple[Inventory, Tasks, Scenario]:
    path = SCENARIOS / f"{name}.yaml"
    inventory_file, tasks_file = load_scenario_paths(path)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, tasks_file)
    return inventory, tasks, load_scenario(path, inventory, tasks)


@pytest.mark.parametrize(
    ("scenario", "policy", "runs"),
    [
        ("paper-2", PolicyName.UTILITY, 6),
        ("paper-2", PolicyName.RANDOM, 3),
        ("paper-1", PolicyName.STATIC_RANDOM, 3),
        ("changing-links", PolicyName.LOCAL, 2),
        ("patrol", PolicyName.STATIC, 1),
    ],
)
def test_a_run_that_shares_is_the_one_that_it_is_alone(scenario: str, policy: PolicyName, runs: int) -> None:
    inventory, tasks, world = load(scenario)
    used = replace(tasks.policy, name=policy)

    def run(number: int, memory: SimMemory | None) -> SimRun:
        dice = partial(random.Random(number).gauss, 0.0, 1.0)
        return simulate_mission(inventory, tasks, world, replace(used, seed=number), dice, memory=memory)

    alone = [describe_run(run(number, None)) for number in range(runs)]
    memory = SimMemory(inventory=inventory, tasks=tasks, scenario=world, policy=used)
    for _ in range(2):  # the second time nearly every state is known
        assert [describe_run(run(number, memory)) for number in range(runs)] == alone
    # With events what is known of a state is not all that counts there.
    assert bool(memory.shares) == (scenario != "patrol")
    assert bool(memory.cycles) == scenario.startswith("paper")


def test_the_memory_of_another_mission_is_refused() -> None:
    inventory, tasks, world = load("paper-2")
    memory = SimMemory(inventory=inventory, tasks=tasks, scenario=world, policy=tasks.policy)
    other = replace(tasks.policy, move_margin=0.7)
    for scenario, policy in ((replace(world, name="other"), tasks.policy), (world, other)):
        with pytest.raises(ValueError, match="another mission or policy"):
            simulate_mission(inventory, tasks, scenario, policy, lambda: 0.0, memory=memory)


@pytest.mark.parametrize("radio", Radio)
def test_a_probe_of_one_host_shows_what_tasks_of_others_leave_it(radio: Radio) -> None:
    """Both links are far. Each has its rate to itself, or half of the time of the channel."""
    inventory, tasks, world = load("changing-links")
    world = replace(world, radio=radio)
    env = simpy.Environment()
    state = SimState(
        env=env, inventory=inventory, tasks=tasks, scenario=world, policy=tasks.policy, draw_normal=lambda: 0.0,
        changed=env.event(), read=env.event(), reference=inventory.edges[0].name, meters={host: HostMeter() for host in world.hosts},
        memory=SimMemory(inventory=inventory, tasks=tasks, scenario=world, policy=tasks.policy),
    )  # fmt: skip
    for name, host in (("detection-robot2", "edge3"), ("detection-robot1", "edge2")):
        state.services[name] = SimTask(task=tasks.tasks[name], host=host, since=0.0, ready=True)

    def probe() -> tuple[float, float]:
        sample = simulate_probe(state).hosts["edge2"]
        return sample.links["robot1"].used_bytes_per_s, sample.tasks["detection-robot1"].links["robot1"]  # type: ignore[index]

    update_speeds(state)
    beside = probe()
    del state.services["detection-robot2"]
    update_speeds(state)
    assert beside[0] == beside[1]
    assert (probe() > beside) is (radio is Radio.SHARED)
    # The same instance of another run was started at another time.
    state.services["detection-robot1"].since = 5.0
    update_speeds(state)
    assert simulate_probe(state).hosts["edge2"].tasks["detection-robot1"].started_at == 5.0


def test_a_memory_does_not_grow_for_ever() -> None:
    inventory, tasks, world = load("paper-2")
    memory = SimMemory(inventory=inventory, tasks=tasks, scenario=world, policy=Policy())
    for number in range(12_000):
        memory.add_shares(number, KnownShares({}, {}, {}, {}))
        memory.add_host(number, KnownShares({}, {}, {}, {}))
        memory.add_sample(number, SimSample(0.0, 0.0, {}, {}))
    assert all(0 < len(kept) <= 5000 for kept in (memory.shares, memory.hosts, memory.samples))
