# SPDX-License-Identifier: Apache-2.0
"""move and unpin commands."""

from typing import Annotated

from typer import Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.task_names import resolve_task_name, select_task_names
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode
from edgectl.formats.document import Document
from edgectl.views.output_format import OutputFormat


def move_command(
    *,
    task: options.TaskArgument,
    host: options.HostArgument,
    duration: Annotated[
        str | None, Option("--for", metavar="TIME", help="How long the pin lasts; default: until unpin.")
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Pin a task to a host: the next apply moves it there, and no load and no weight moves it away until the
    time is over or it is unpinned.

    Refused where the host can never run the task. While the host is lost, cordoned or drained, the pin does
    not count. Exit 4 if the host does not answer.

    Examples:
        edgectl move navigation-robot1 edge2
        edgectl move navigation-robot1 edge2 --for 1h
        edgectl move navigation-robot1 edge2 --dry-run
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.usecases.pins import pin_task
    from edgectl.views.describe_task import encode_decision
    from edgectl.views.marks import Mark, MarksView
    from edgectl.views.reasons import describe_pin, describe_reason
    from edgectl.views.rows import encode_pin

    loaded = load_inputs(inventory, tasks)
    task = resolve_task_name(task, loaded.tasks)
    moved = pin_task(
        build_fleet(loaded),
        loaded.tasks.policy,
        task,
        host,
        duration=None if duration is None else parse_duration_option(duration, "--for"),
        dry_run=dry_run,
    )
    details: Document = {
        "pin": encode_pin(moved.pin, moved.pin.since),
        "decision": encode_decision(moved.step),
    }
    mark = Mark(subject="task", name=task, act=describe_pin(moved.pin), again=moved.again, details=details)
    console.print_view(MarksView("move", [mark], dry_run=dry_run), output)
    console.print_message(f"next apply: {describe_reason(moved.step)}")
    raise Exit(exit_codes.of_plan(moved.plan, detailed=False, allow_unreachable=True))


def unpin_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    dry_run: options.DryRunMarkOption = False,
) -> None:
    """Remove the pins that move has set. The tasks stay where they are until a plan finds a better host.

    Examples:
        edgectl unpin navigation-robot1
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.pins import unpin_tasks
    from edgectl.views.marks import Mark, MarksView

    fleet = build_fleet(load_inputs(inventory, tasks))
    chosen = select_task_names(names or (), selector, fleet.tasks)
    found = unpin_tasks(fleet, chosen, dry_run=dry_run)
    marks = [
        Mark(subject="task", name=name, act="unpinned", again=not pinned) for name, pinned in found.items()
    ]
    stated = [task for name in found if (task := fleet.tasks.tasks.get(name)) is not None]
    notes = [
        f"{task.name} is pinned to {task.hosts.pin} by hosts.pin of {task.template} in its task file"
        for task in stated
        if task.hosts.pin is not None
    ]
    console.print_view(MarksView("unpin", marks, notes, dry_run=dry_run), output)
    raise Exit(ExitCode.DONE)
