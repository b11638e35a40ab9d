# SPDX-License-Identifier: Apache-2.0
"""probe command."""

from pathlib import Path
from typing import Annotated

from typer import Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs, save_file
from edgectl.views.output_format import OutputFormat


def probe_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FleetOutput = OutputFormat.TABLE,
    out: Annotated[
        Path | None, Option("--out", metavar="FILE", help="Save the snapshot for edgectl plan --snapshot.")
    ] = None,
    window: options.WindowOption = "0.5s",
    timeout: options.TimeoutOption = "15s",
    bandwidth: Annotated[
        bool, Option("--bandwidth", help="First measure each link by sending for 2 s.")
    ] = False,
    accept_new: options.AcceptNewOption = False,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Measure hosts, links and tasks. Nothing is changed.

    Examples:
        edgectl probe
        edgectl probe -o wide --window 2s
        edgectl probe --out now.json
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.gateway.host_probe import ProbeOptions
    from edgectl.usecases.probe import measure_links, probe_fleet
    from edgectl.views.output import render_view
    from edgectl.views.progress import show_probe_progress
    from edgectl.views.snapshot import SnapshotView

    fleet = build_fleet(load_inputs(inventory, tasks, needs_tasks=False), accept_new=accept_new)
    links = measure_links(fleet) if bandwidth else ()
    with show_probe_progress(len(fleet.inventory.hosts)) as heard:
        how = ProbeOptions(
            window=parse_duration_option(window, "--window"),
            timeout=parse_duration_option(timeout, "--timeout"),
            on_host=heard,
        )
        snapshot = probe_fleet(fleet, how)
    if out is not None:
        save_file(out, render_view(SnapshotView(snapshot), OutputFormat.JSON))
    console.print_view(SnapshotView(snapshot, links), output, fleet=fleet.inventory.fleet)
    raise Exit(exit_codes.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))
