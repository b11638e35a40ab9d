# SPDX-License-Identifier: Apache-2.0
"""Commands for resident profilers: start, stop, status."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, NoReturn

from typer import Argument, Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.completion import complete_hosts as host_names
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.usecases.fleet import Fleet

_HostsArgument = Annotated[
    list[str] | None,
    Argument(
        metavar="[HOST...]",
        autocompletion=host_names,
        parser=options.strip_host_kind,
        help="Names in the inventory; default: all.",
        show_default=False,
    ),
]


def profilers_start_command(
    *,
    hosts: _HostsArgument = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    every: Annotated[str, Option("--every", metavar="TIME", help="Sampling period, 100ms to 1m.")] = "1s",
    ttl: Annotated[
        str, Option("--ttl", metavar="TIME", help="End after this time without a request.")
    ] = "1h",
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Start a resident profiler on each host, so that a probe needs no sample window.

    Run it again after a change of robots or detect, and after a reboot; profilers with the same options are
    kept.

    Examples:
        edgectl profilers start
        edgectl profilers start edge1 --every 500ms --ttl 1d
        edgectl profilers start --dry-run
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.usecases.profilers import start_profilers
    from edgectl.views.profilers import ProfilersView

    fleet = build_fleet(load_inputs(inventory, tasks))
    if dry_run:
        _print_present(fleet, hosts or (), "start", output)
    found = start_profilers(
        fleet,
        hosts or (),
        every=parse_duration_option(every, "--every"),
        ttl=parse_duration_option(ttl, "--ttl"),
    )
    console.print_view(ProfilersView(found), output, fleet=fleet.inventory.fleet)
    raise Exit(exit_codes.of_profilers(found))


def profilers_status_command(
    *,
    hosts: _HostsArgument = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
) -> None:
    """Show resident profilers, their cost and their remaining time.

    Examples:
        edgectl profilers status
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.profilers import list_profilers
    from edgectl.views.profilers import ProfilersView

    fleet = build_fleet(load_inputs(inventory, tasks))
    found = list_profilers(fleet, hosts or ())
    console.print_view(ProfilersView(found), output, fleet=fleet.inventory.fleet)
    raise Exit(exit_codes.of_profilers(found))


def profilers_stop_command(
    *,
    hosts: _HostsArgument = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Stop resident profilers and verify that they are gone. Probes use a sample window again.

    Examples:
        edgectl profilers stop
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.profilers import stop_profilers
    from edgectl.views.profilers import ProfilersView

    fleet = build_fleet(load_inputs(inventory, tasks))
    if dry_run:
        _print_present(fleet, hosts or (), "stop", output)
    found = stop_profilers(fleet, hosts or ())
    console.print_view(ProfilersView(found), output, fleet=fleet.inventory.fleet)
    raise Exit(exit_codes.of_profilers(found))


def _print_present(fleet: "Fleet", hosts: Sequence[str], verb: str, output: OutputFormat) -> NoReturn:
    """A dry run: what runs now, and on which hosts a profiler would be started or stopped."""
    from edgectl.model.profiler import ProfilerState
    from edgectl.usecases.profilers import list_profilers
    from edgectl.views.profilers import ProfilersView

    found = list_profilers(fleet, hosts)
    console.print_view(ProfilersView(found), output, fleet=fleet.inventory.fleet)
    for each in found:
        running = each.state in (ProfilerState.RUNNING, ProfilerState.STALLED)
        changes = running if verb == "stop" else not (running and each.current)
        if changes and each.state is not ProfilerState.UNREACHABLE:
            console.print_message(f"{each.host}: profiler would {verb} (dry run)")
    raise Exit(exit_codes.of_profilers(found))
