"""Worlds of a sweep on a Dask cluster: DASK_SCHEDULER_ADDRESS, or one on this machine."""

from collections.abc import Iterator, Sequence

from distributed import Client, as_completed

from edgectl.experiments.model.sweep import SweepWorld, WorldResult
from edgectl.experiments.sweep_runs import simulate_world


def simulate_on_dask(worlds: Sequence[SweepWorld]) -> Iterator[WorldResult]:
    """The results, in the order in which they come. Dask repeats the worlds of a worker that is lost."""
    with Client(dashboard_address=None, set_as_default=False) as client:
        futures = client.map(simulate_world, worlds, key=[world.digest for world in worlds], retries=3)
        for future in as_completed(futures):
            yield future.result()
