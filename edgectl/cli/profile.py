# SPDX-License-Identifier: Apache-2.0
"""profile command."""

from typing import Annotated

from typer import Exit, Option

from edgectl.cli import apply_session, console, options
from edgectl.cli.project import choose_files
from edgectl.cli.user_files import list_task_files, load_inputs, replace_file_text
from edgectl.errors import ExitCode
from edgectl.names import check_known_names
from edgectl.views.output_format import OutputFormat


def profile_command(
    *,
    task: options.TaskArgument,
    write: Annotated[bool, Option("--write", help="Save p95 as the demand in the task file.")] = False,
    service: Annotated[
        str | None, Option("--service", metavar="METRIC", help="Show its service time by this metric in ms.")
    ] = None,
    yes: options.YesOption = False,
    dry_run: Annotated[bool, Option("--dry-run", help="With --write: only print the change.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
) -> None:
    """Show measured usage of a task by class of hosts (median, p95, maximum) beside its declared demand. No
    host is contacted.

    TASK may be an entry with for_each. --write shows the change and asks for confirmation. --service METRIC
    prints lines for the task file: p50 and p95 of an application metric while others left the host idle.

    Examples:
        edgectl profile slam-robot1
        edgectl profile slam-robot1 -o json
        edgectl profile slam-robot1 --service frame_ms
        edgectl profile slam-robot1 --write --yes
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.measured_demand import load_class_profiles, load_service_times
    from edgectl.usecases.profile import build_demand_edit, get_tasks_by_name
    from edgectl.views.profile import ProfileView, list_service_lines

    first = "check first: edgectl profile TASK --write --dry-run"
    apply_session.check_can_confirm(asked=write and not (yes or dry_run), first=first)
    files = list_task_files(choose_files(inventory, tasks))
    fleet = build_fleet(load_inputs(inventory, files))
    check_known_names(
        [task], [*fleet.tasks.tasks, *(each.template for each in fleet.tasks.tasks.values())], "task"
    )
    named = get_tasks_by_name(fleet.tasks, task)
    console.print_view(ProfileView(load_class_profiles(fleet, named)), output, fleet=fleet.inventory.fleet)
    if service is not None:
        for line in list_service_lines(named, service, load_service_times(fleet, named, service)):
            console.print_message(line)
    if not write:
        return
    change = build_demand_edit(fleet, files, named[0])
    if change.before == change.after:
        console.print_message(f"{change.file} is up to date")
        return
    if len(change.tasks) > 1:
        console.print_message(
            f"{change.entry} is one entry for {', '.join(change.tasks)}: it gets the maximum of their p95"
        )
    console.print_stderr(change.diff())
    if dry_run:
        return
    if not yes and not apply_session.ask_confirmation(
        f'Write this to {change.file} of fleet {fleet.inventory.fleet}? Only "yes" is accepted: '
    ):
        raise Exit(ExitCode.FAILED)
    replace_file_text(change.file, change.before, change.after)
    console.print_message(f"wrote {change.file}")
