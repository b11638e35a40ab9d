# SPDX-License-Identifier: Apache-2.0
"""Worlds of a sweep on a Dask cluster: DASK_SCHEDULER_ADDRESS, or one on this machine."""

from collections.abc import Iterator, Sequence

from distributed import Client, as_completed

from edgectl.errors import EdgectlError
from edgectl.experiments.model.sweep import SweepWorld, WorldResult
from edgectl.experiments.sweep_runs import simulate_world


def simulate_on_dask(worlds: Sequence[SweepWorld]) -> Iterator[WorldResult]:
    """The results, in the order in which they come. Dask repeats the worlds of a worker that is lost.

    Raises:
        EdgectlError: the scheduler cannot be reached.
    """
    try:
        client = Client()
    except OSError as error:
        raise EdgectlError(f"Dask: {error}", hint="check DASK_SCHEDULER_ADDRESS") from error
    with client:
        keys = [f"edgectl-{world.digest}" for world in worlds]
        for future in as_completed(client.map(simulate_world, worlds, key=keys, retries=3)):
            yield future.result()
