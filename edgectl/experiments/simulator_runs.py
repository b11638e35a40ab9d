"""simulate: run a mission in the model, several times under every scheme."""

import random
from collections.abc import Iterator, Sequence
from functools import partial

from edgectl.experiments.model.comparison import Scheme, SchemeResult
from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.scheme_results import summarize_sim_runs
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks


def simulate_schemes(
    inventory: Inventory,
    tasks: Tasks,
    scenario: Scenario,
    variants: Sequence[Scheme],
    *,
    runs: int,
    seed: int,
) -> Iterator[SchemeResult]:
    """Each variant over the same ``runs`` draws of the mission: the same seed gives the same numbers."""
    for variant in variants:
        draws = (random.Random(f"{seed}/{run}") for run in range(runs))  # noqa: S311 - a model, no secret
        found = [
            simulate_mission(inventory, tasks, scenario, variant.policy, partial(dice.gauss, 0.0, 1.0))
            for dice in draws
        ]
        yield summarize_sim_runs(inventory, variant, found)
