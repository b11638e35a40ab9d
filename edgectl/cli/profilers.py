"""profilers start, profilers stop, profilers status."""

from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, exits, options
from edgectl.cli.complete import hosts as host_names
from edgectl.cli.inputs import load
from edgectl.views.form import Form

_Hosts = Annotated[
    list[str] | None, Argument(metavar="[HOST...]", autocompletion=host_names, help="Names in the inventory; all.", show_default=False)
]


def profilers_start_command(
    *,
    hosts: _Hosts = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ResultOutput = Form.TABLE,
    every: Annotated[str, Option("--every", metavar="TIME", help="From sample to sample, 100ms to 1m.")] = "1s",
    ttl: Annotated[str, Option("--ttl", metavar="TIME", help="End after so long without a call.")] = "1h",
) -> None:
    """Start a small process on each host that measures all the time, so that a probe needs no sample window.

    Start them again after a change of robots or of detect, and after a host was rebooted: what runs and fits stays.

    Examples:
        edgectl profilers start
        edgectl profilers start edge1 --every 500ms --ttl 1d
    """
    from edgectl.cli.reach import reach, seconds
    from edgectl.usecases.profilers import start

    fleet = reach(load(inventory, tasks))
    found = start(fleet, hosts or (), every=seconds(every, "--every"), ttl=seconds(ttl, "--ttl"))
    console.show(output, "profilers", found)
    raise Exit(exits.of_profilers(found))


def profilers_status_command(
    *,
    hosts: _Hosts = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ResultOutput = Form.TABLE,
) -> None:
    """Show which profilers run, what they cost and when they would end.

    Examples:
        edgectl profilers status
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases.profilers import status

    found = status(reach(load(inventory, tasks)), hosts or ())
    console.show(output, "profilers", found)
    raise Exit(exits.of_profilers(found))


def profilers_stop_command(
    *,
    hosts: _Hosts = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ResultOutput = Form.TABLE,
) -> None:
    """Stop the profilers and prove that they are gone. Probes measure over a window again.

    Examples:
        edgectl profilers stop
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases.profilers import stop

    found = stop(reach(load(inventory, tasks)), hosts or ())
    console.show(output, "profilers", found)
    raise Exit(exits.of_profilers(found))
