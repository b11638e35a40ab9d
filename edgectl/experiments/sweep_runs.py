# SPDX-License-Identifier: Apache-2.0
"""Simulation of one world of a sweep: pairs of runs, until all are made or the fastest scheme is certain."""

import random
from functools import partial

from edgectl.experiments.event_draws import build_uniform_draw
from edgectl.experiments.model.scenario import SimRun
from edgectl.experiments.model.sweep import SchemeRuns, SweepWorld, WorldResult
from edgectl.experiments.sequential_test import find_certain_winner
from edgectl.experiments.simulator import simulate_mission
from edgectl.experiments.simulator_memory import SimMemory
from edgectl.scheduler.garbage import pause_collection


@pause_collection()
def simulate_world(world: SweepWorld) -> WorldResult:
    """The runs of all schemes. The same world gives the same result, wherever it is simulated."""
    runs: dict[str, list[SimRun]] = {scheme.name: [] for scheme in world.schemes}
    memories = {
        scheme.name: SimMemory(
            inventory=world.inventory, tasks=world.tasks, scenario=world.scenario, policy=scheme.policy
        )
        for scheme in world.schemes
    }
    winner, made = None, 0
    while made < world.bounds.runs and winner is None:
        seed = f"{world.bounds.seed}/{made}"
        for scheme in world.schemes:
            dice = random.Random(seed)  # noqa: S311 - not for security
            runs[scheme.name].append(
                simulate_mission(
                    world.inventory,
                    world.tasks,
                    world.scenario,
                    scheme.policy,
                    partial(dice.gauss, 0.0, 1.0),
                    build_uniform_draw(seed),
                    memory=memories[scheme.name],
                )
            )
        made += 1
        if world.bounds.error is not None and len(world.schemes) > 1:
            times = {name: [run.latency for run in each] for name, each in runs.items()}
            winner = find_certain_winner(times, world.bounds.error)
    return WorldResult(
        digest=world.digest,
        runs=made,
        schemes={name: _summarize_runs(each) for name, each in runs.items()},
        winner=winner or "",
    )


def _summarize_runs(runs: list[SimRun]) -> SchemeRuns:
    return SchemeRuns(
        latency=tuple(run.latency for run in runs),
        handoffs=tuple(run.handoffs for run in runs),
        unplaced=tuple(run.unplaced for run in runs),
        unfinished=sum(not run.finished for run in runs),
    )
