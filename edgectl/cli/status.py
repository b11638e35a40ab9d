# SPDX-License-Identifier: Apache-2.0
"""status command."""

from typing import TYPE_CHECKING

from typer import Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.model.snapshot import Snapshot


def status_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FleetOutput = OutputFormat.TABLE,
    watch: options.WatchOption = False,
    every: options.EveryOption = "2s",
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show where tasks run, their age, and their usage against demand. Exit 4 while a wanted task has failed.

    With -w, refresh until Ctrl-C; -o json then prints one object per line.

    Examples:
        edgectl status
        edgectl status -o json
        edgectl status -o wide
        edgectl status -w --every 5s
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.plan import find_fleet_shortages
    from edgectl.usecases.probe import probe_fleet
    from edgectl.views.status import StatusView

    fleet = build_fleet(load_inputs(inventory, tasks))

    def build(seen: "Snapshot") -> StatusView:
        return StatusView(seen, fleet.inventory, fleet.tasks, find_fleet_shortages(fleet, seen))

    if watch:
        from edgectl.cli.signals import catch_stop_signals, parse_every_option
        from edgectl.usecases.status import probe_repeatedly
        from edgectl.views.output_format import NAMED_STREAM_FORMATS, check_output_format

        check_output_format(output, NAMED_STREAM_FORMATS)
        with catch_stop_signals(parse_every_option(every)) as end:
            console.print_view_series(map(build, probe_repeatedly(fleet, end)), output)
        return
    snapshot = probe_fleet(fleet)
    console.print_view(build(snapshot), output)
    raise Exit(
        exit_codes.of_status(snapshot, fleet.inventory, fleet.tasks, allow_unreachable=allow_unreachable)
    )
