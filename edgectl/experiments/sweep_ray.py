# SPDX-License-Identifier: Apache-2.0
"""Worlds of a sweep on a Ray cluster: RAY_ADDRESS, or one on this machine."""

from collections.abc import Iterator, Sequence

import ray

from edgectl.errors import EdgectlError
from edgectl.experiments.model.sweep import SweepWorld, WorldResult
from edgectl.experiments.sweep_runs import simulate_world


def simulate_on_ray(worlds: Sequence[SweepWorld]) -> Iterator[WorldResult]:
    """The results, in the order in which they come. Ray repeats the worlds of a node that is lost.

    Raises:
        EdgectlError: the cluster cannot be reached.
    """
    try:
        ray.init(log_to_driver=False, logging_level="error")
    except (ConnectionError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise EdgectlError(f"Ray: {reason}", hint="check RAY_ADDRESS") from error
    try:
        simulate = ray.remote(max_retries=3)(simulate_world)
        left = [simulate.remote(world) for world in worlds]
        while left:
            ready, left = ray.wait(left)
            yield from ray.get(ready)
    finally:
        ray.shutdown()
