# SPDX-License-Identifier: Apache-2.0
"""doctor command."""

from typing import Annotated

from typer import Argument, Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.completion import complete_hosts as host_names
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat


def doctor_command(
    *,
    hosts: Annotated[
        list[str] | None,
        Argument(
            metavar="[HOST...]",
            autocompletion=host_names,
            parser=options.strip_host_kind,
            help="Names in the inventory; default: all.",
            show_default=False,
        ),
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.DiagnosisOutput = OutputFormat.TABLE,
    timeout: options.TimeoutOption = "15s",
) -> None:
    """Diagnose this machine, the hosts, the links between them, and what the edges lack for the tasks, with a
    fix for each finding. Nothing is changed.

    Exit code 1 if a check failed; warnings alone exit with 0. -o markdown is a report to paste into an issue,
    with the versions.

    Examples:
        edgectl doctor
        edgectl doctor edge1 -o json
        edgectl doctor -o markdown
    """
    from edgectl.cli.connect import build_fleet_with_state_check, parse_duration_option
    from edgectl.usecases.doctor import run_doctor
    from edgectl.views.diagnosis import DiagnosisView

    loaded = load_inputs(inventory, tasks, needs_tasks=False)
    fleet, state = build_fleet_with_state_check(loaded)
    diagnosis = run_doctor(fleet, state, hosts or (), timeout=parse_duration_option(timeout, "--timeout"))
    console.print_view(DiagnosisView(diagnosis), output, fleet=fleet.inventory.fleet)
    raise Exit(exit_codes.of_diagnosis(diagnosis))
