# SPDX-License-Identifier: Apache-2.0
"""Commands for the byte counters of hosts: install, show, remove."""

from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.completion import complete_hosts as host_names
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat

_HostsArgument = Annotated[
    list[str] | None,
    Argument(
        metavar="[HOST...]",
        autocompletion=host_names,
        parser=options.strip_host_kind,
        help="Edges of the inventory; default: all.",
        show_default=False,
    ),
]
_DryRunOption = Annotated[bool, Option("--dry-run", help="Only print the script for root of each host.")]
_ScriptOption = Annotated[bool, Option("--script", help="Only print the script for root of the one HOST.")]


def counters_install_command(
    *,
    hosts: _HostsArgument = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    script: _ScriptOption = False,
    dry_run: _DryRunOption = False,
) -> None:
    """Install byte counters of nftables on edges, so that UDP is measured too, as of ROS 2.

    Needs root once per host: a login as root, or sudo. Run it again after a change of robots.

    Examples:
        edgectl counters install
        edgectl counters install edge1 --script
    """
    _run_action("install", hosts or [], inventory, tasks, output, script=script, dry_run=dry_run)


def counters_remove_command(
    *,
    hosts: _HostsArgument = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    script: _ScriptOption = False,
    dry_run: _DryRunOption = False,
) -> None:
    """Remove the byte counters of this fleet from edges, and nothing else.

    Examples:
        edgectl counters remove edge1
    """
    _run_action("remove", hosts or [], inventory, tasks, output, script=script, dry_run=dry_run)


def counters_show_command(
    *,
    hosts: _HostsArgument = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
) -> None:
    """Show the bytes of each robot since the installation, and the rates of one second.

    Examples:
        edgectl counters show
        edgectl counters show edge1 -o json
    """
    _run_action("show", hosts or [], inventory, tasks, output, script=False)


def _run_action(
    action: str,
    hosts: list[str],
    inventory: options.InventoryOption,
    tasks: options.TasksOption,
    output: OutputFormat,
    *,
    script: bool,
    dry_run: bool = False,
) -> None:
    from edgectl.cli.connect import build_fleet
    from edgectl.errors import UsageError
    from edgectl.usecases.byte_counters import ask_counters, build_script
    from edgectl.views.byte_counters import ByteCountersView

    if script and len(hosts) != 1:
        raise UsageError("--script needs one HOST", hint=f"edgectl counters {action} HOST --script")
    fleet = build_fleet(load_inputs(inventory, tasks))
    if script:
        console.print_text(build_script(fleet, hosts[0], action))
        return
    if dry_run:
        for name in hosts or [edge.name for edge in fleet.inventory.edges]:
            console.print_text(f"# {name}\n{build_script(fleet, name, action)}")
        return
    found = ask_counters(fleet, hosts, action)
    console.print_view(ByteCountersView(found), output, fleet=fleet.inventory.fleet)
    raise Exit(exit_codes.of_counters(found))
