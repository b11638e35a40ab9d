# SPDX-License-Identifier: Apache-2.0
"""status and logs commands."""

from collections.abc import Iterable
from typing import Annotated

from typer import Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat


def status_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FleetOutput = OutputFormat.TABLE,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show where tasks run, their age, and their usage against demand. Exit 4 while a wanted task has failed.

    Examples:
        edgectl status
        edgectl status -o json
        edgectl status -o wide
        edgectl status -o name
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.plan import find_fleet_shortages
    from edgectl.usecases.probe import probe_fleet
    from edgectl.views.status import StatusView

    fleet = build_fleet(load_inputs(inventory, tasks))
    snapshot = probe_fleet(fleet)
    shortages = find_fleet_shortages(fleet, snapshot)
    console.print_view(StatusView(snapshot, fleet.inventory, fleet.tasks, shortages), output)
    raise Exit(
        exit_codes.of_status(snapshot, fleet.inventory, fleet.tasks, allow_unreachable=allow_unreachable)
    )


def logs_command(
    *,
    task: options.TaskArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    follow: Annotated[bool, Option("--follow", "-f", help="Keep printing until Ctrl-C.")] = False,
    tail: Annotated[
        int, Option("--tail", "-n", metavar="N", min=0, help="Number of last lines to print.")
    ] = 100,
    raw: Annotated[bool, Option("--raw", help="Leave control sequences of the task in.")] = False,
) -> None:
    """Print the logs of a task from the host where it runs or ran last, without control sequences.

    Examples:
        edgectl logs slam-robot1
        edgectl logs slam-robot1 --tail 20
        edgectl logs slam-robot1 -f
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases import logs
    from edgectl.views.text import decode_log

    fleet = build_fleet(load_inputs(inventory, tasks))
    if follow:
        found: Iterable[bytes] = logs.follow_log(fleet, task, tail=tail)
    else:
        found = [logs.read_log(fleet, task, tail=tail).encode()]
        if found == [b""]:
            console.print_message("the log is empty")
    for text in decode_log(found, raw=raw):
        if not console.print_part(text):
            return
