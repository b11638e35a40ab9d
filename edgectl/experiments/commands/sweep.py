# SPDX-License-Identifier: Apache-2.0
"""The commands simulate sweep and simulate merge."""

import contextlib
import re
from collections.abc import Generator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from edgectl.cli import console, options
from edgectl.cli.connect import print_warning
from edgectl.errors import EdgectlError, UsageError
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.experiments.model.sweep import Sweep, SweepWorld, WorldResult
    from edgectl.experiments.views.sweep import SweepView

SWEEPS_DIR = Path("runs") / "sweeps"
# Array jobs that Slurm gets unless --workers says how many.
SLURM_JOBS = 100
_SpecArgument = Annotated[Path, Argument(metavar="SPEC", help="A sweep file.", show_default=False)]


class Engine(StrEnum):
    """Where the worlds of a sweep are simulated."""

    LOCAL = "local"
    RAY = "ray"
    DASK = "dask"
    SLURM = "slurm"


def simulate_sweep_command(
    *,
    spec: _SpecArgument,
    out: Annotated[
        Path | None,
        Option(
            "--out", metavar="DIR", help="Directory of the results; default: runs/sweeps.", show_default=False
        ),
    ] = None,
    shard: Annotated[
        str | None, Option("--shard", metavar="I/N", help="Only part I of N, for one of N machines.")
    ] = None,
    workers: Annotated[
        int | None,
        Option(
            "--workers",
            metavar="N",
            min=1,
            max=1000,
            help="Processes; default: cores. On slurm: jobs.",
            show_default=False,
        ),
    ] = None,
    engine: Annotated[
        Engine, Option("--on", metavar="ENGINE", help="local, ray, dask or slurm.")
    ] = Engine.LOCAL,
    output: options.WideOutput = OutputFormat.TABLE,
) -> None:
    """Simulate a mission under several schemes in all worlds of a sweep file, on all cores.

    Results are files named by the digest of their world. Existing ones are not computed again: to resume an
    interrupted sweep, repeat the command. Requires the extra evidence.

    Examples:
        edgectl simulate sweep docs/scenarios/sweep-robots.yaml
        edgectl simulate sweep docs/scenarios/sweep-robots.yaml --shard 1/2 --out p
    """
    from edgectl.experiments.files.sweep_file import load_sweep
    from edgectl.experiments.files.sweep_results import (
        create_directory,
        list_missing,
        load_results,
        save_result,
        select_worlds,
    )
    from edgectl.experiments.views.progress import show_world_progress

    if engine is not Engine.LOCAL and shard is not None:
        raise UsageError(
            "--shard is for --on local", hint=f"leave it out: {engine} divides the worlds itself"
        )
    sweep, directory = load_sweep(spec), out or SWEEPS_DIR
    create_directory(directory)
    worlds = select_worlds(sweep.worlds, parse_shard(shard))
    missing = list_missing(worlds, load_results(worlds, [directory], print_warning))
    if engine is Engine.SLURM and missing:
        from edgectl.experiments.sweep_slurm import submit_shards

        submit_shards(spec, directory, min(workers or SLURM_JOBS, len(missing)))
    else:
        with (
            show_world_progress(len(missing)) as advance,
            contextlib.closing(_simulate(missing, engine, workers)) as results,
        ):
            for result in results:
                save_result(directory, result)
                advance()
    if shard is None:
        console.print_view(_build_view(sweep, [directory]), output)
    else:
        known = len(worlds) - len(missing)
        console.print_message(f"shard {shard}: worlds simulated: {len(missing)}, known: {known}")


def simulate_merge_command(
    *,
    spec: _SpecArgument,
    directories: Annotated[
        list[Path] | None,
        Argument(metavar="[DIR]..", help="Directories of results; default: runs/sweeps.", show_default=False),
    ] = None,
    output: options.WideOutput = OutputFormat.TABLE,
) -> None:
    """Merge the results of the shards of a sweep. The bytes do not depend on the number of shards.

    Examples:
        edgectl simulate merge docs/scenarios/sweep-robots.yaml part-1 part-2
        edgectl simulate merge docs/scenarios/sweep-robots.yaml part-1 part-2 -o csv
    """
    from edgectl.experiments.files.sweep_file import load_sweep

    console.print_view(_build_view(load_sweep(spec), directories or [SWEEPS_DIR]), output)


def parse_shard(text: str | None) -> tuple[int, int]:
    """(I, N) of ``I/N``; (1, 1) for None.

    Raises:
        UsageError: it is not of that form, or I is not in 1..N.
    """
    if text is None:
        return 1, 1
    parts = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
    number, count = (int(part) for part in parts.groups()) if parts else (0, 0)
    if not 1 <= number <= count:
        raise UsageError(f"--shard: invalid shard {text!r}", hint="write 1/4 for the first of four")
    return number, count


def _simulate(
    worlds: "Sequence[SweepWorld]", engine: Engine, workers: int | None
) -> "Generator[WorldResult, None, None]":
    """The results as they come. What an engine needs is imported only where there is something to do."""
    from edgectl.cli.extras import require_extra

    if not worlds:
        return
    with require_extra("evidence"):
        from edgectl.experiments.sweep_local import count_cores, simulate_on_cores
    if engine is Engine.LOCAL:
        yield from simulate_on_cores(worlds, workers or count_cores(), print_warning)
        return
    if workers is not None:
        raise UsageError(
            f"--workers is not for --on {engine}", hint="drop it: the cluster uses all of its cores"
        )
    with require_extra(engine.value):
        if engine is Engine.RAY:
            from edgectl.experiments.sweep_ray import simulate_on_ray as simulate
        else:
            from edgectl.experiments.sweep_dask import simulate_on_dask as simulate
    yield from simulate(worlds)


def _build_view(sweep: "Sweep", directories: list[Path]) -> "SweepView":
    from edgectl.experiments.files.sweep_results import list_missing, load_results, select_worlds
    from edgectl.experiments.views.sweep import SweepView

    worlds = select_worlds(sweep.worlds)
    results = load_results(worlds, directories, print_warning)
    missing = len(list_missing(worlds, results))
    if missing:
        raise EdgectlError(
            f"{missing} of {len(worlds)} worlds have no result in {', '.join(map(str, directories))}",
            hint="run edgectl simulate sweep with the shards that are missing, or name their directories",
        )
    return SweepView(sweep=sweep, results=results)
