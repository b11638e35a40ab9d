"""status and logs."""

from typing import Annotated

from typer import Exit, Option

from edgectl.cli import console, exits, options
from edgectl.cli.inputs import load
from edgectl.views.form import Form


def status_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FleetOutput = Form.TABLE,
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Show what runs where, since when, and what it uses against its demand.

    Examples:
        edgectl status
        edgectl status -o json
        edgectl status -o name
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases.probe import probe

    fleet = reach(load(inventory, tasks))
    snapshot = probe(fleet)
    console.show(output, "status", snapshot, fleet.inventory, fleet.tasks)
    raise Exit(exits.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def logs_command(
    *,
    task: options.TaskArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    follow: Annotated[bool, Option("--follow", "-f", help="Go on as more is printed, until Ctrl-C.")] = False,
    tail: Annotated[int, Option("--tail", "-n", metavar="N", min=0, help="How many of the last lines.")] = 100,
) -> None:
    """Print the log of a task, from the host where it runs or ran last.

    Examples:
        edgectl logs slam-robot1
        edgectl logs slam-robot1 --tail 20
        edgectl logs slam-robot1 -f
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases import logs

    fleet = reach(load(inventory, tasks))
    if not follow:
        text = logs.logs(fleet, task, tail=tail)
        console.put_log(text.encode()) if text else console.tell("nothing was printed")
        return
    for part in logs.follow(fleet, task, tail=tail):
        if not console.put_log(part):
            return
