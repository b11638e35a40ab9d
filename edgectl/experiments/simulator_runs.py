# SPDX-License-Identifier: Apache-2.0
"""Simulate a mission several times under each scheme, with random numbers from a seed."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

from edgectl.experiments.event_draws import build_uniform_draw, create_stream
from edgectl.experiments.event_results import measure_sim_recoveries, summarize_events, summarize_kinds
from edgectl.experiments.model.comparison import SchemeResult
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.scheme_results import summarize_sim_runs
from edgectl.experiments.simulator import simulate_mission
from edgectl.experiments.simulator_memory import SimMemory
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
        memory = SimMemory(inventory=inventory, tasks=tasks, scenario=scenario, policy=scheme.policy)
        sim_runs = [
            simulate_mission(
                inventory,
                tasks,
                scenario,
                replace(scheme.policy, seed=_MAX_RUNS * seed + run),
                partial(create_stream(f"{seed}/{run}").gauss, 0.0, 1.0),
                build_uniform_draw(f"{seed}/{run}"),
                oracle=scheme.oracle,
                memory=memory,
            )
            for run in range(runs)
        ]
        recovered = [measure_sim_recoveries(run, scenario.timing.every) for run in sim_runs]
        result = summarize_sim_runs(inventory, scheme, sim_runs)
        yield replace(result, events=summarize_events(recovered), recoveries=summarize_kinds(recovered))
