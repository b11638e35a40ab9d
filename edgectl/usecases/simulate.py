"""simulate: run a mission in the model, several times under every scheme."""

import random
from collections.abc import Iterator, Sequence
from functools import partial

from edgectl.evidence.figures import summed_up
from edgectl.evidence.simulate import simulate as one
from edgectl.model.evidence import Column, Variant
from edgectl.model.inventory import Inventory
from edgectl.model.scenario import Scenario
from edgectl.model.task import Tasks


def simulate(
    inventory: Inventory, tasks: Tasks, scenario: Scenario, variants: Sequence[Variant], *, runs: int, seed: int
) -> Iterator[Column]:
    """Each variant over the same ``runs`` draws of the mission: the same seed gives the same numbers."""
    for variant in variants:
        draws = (random.Random(f"{seed}/{run}") for run in range(runs))  # noqa: S311 - a model, no secret
        found = [one(inventory, tasks, scenario, variant.policy, partial(dice.gauss, 0.0, 1.0)) for dice in draws]
        yield summed_up(inventory, variant, found)
