# SPDX-License-Identifier: Apache-2.0
"""Simulate a mission several times under each scheme, with random numbers from a seed."""

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from edgectl.experiments.model.comparison import SchemeResult
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.scheme_results import summarize_sim_runs
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks

# No two runs of two seeds place at random alike.
_MAX_RUNS = 1000


def simulate_schemes(
    inventory: Inventory,
    tasks: Tasks,
    scenario: Scenario,
    schemes: Sequence[Scheme],
    *,
    runs: int,
    seed: int,
) -> Iterator[SchemeResult]:
    """Results of each scheme over the same ``runs`` random draws; the same seed gives the same results."""
    for scheme in schemes:
        sim_runs = [
            simulate_mission(
                inventory,
                tasks,
                scenario,
                replace(scheme.policy, seed=_MAX_RUNS * seed + run),
                partial(_create_stream(f"{seed}/{run}").gauss, 0.0, 1.0),
                build_uniform_draw(f"{seed}/{run}"),
            )
            for run in range(runs)
        ]
        yield summarize_sim_runs(inventory, scheme, sim_runs)


def build_uniform_draw(seed: str) -> Callable[[str], float]:
    """Draws from 0 to 1 from a stream for each name: none depends on how often another is used."""
    streams: dict[str, random.Random] = {}

    def draw(name: str) -> float:
        if name not in streams:
            streams[name] = _create_stream(f"{seed}/event/{name}")
        return streams[name].random()

    return draw


def _create_stream(seed: str) -> random.Random:
    return random.Random(seed)  # noqa: S311 - not for security
