# SPDX-License-Identifier: Apache-2.0
"""wait command."""

from typing import TYPE_CHECKING, Annotated

from typer import Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.signals import catch_stop_signals, parse_every_option
from edgectl.cli.task_names import select_task_names
from edgectl.cli.user_files import load_inputs
from edgectl.rules.awaited_state import AwaitedState
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.rules.awaited_state import TaskProgress


def wait_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    awaited: Annotated[
        AwaitedState, Option("--for", metavar="STATE", help="ready, completed or gone.")
    ] = AwaitedState.READY,
    timeout: Annotated[str, Option("--timeout", metavar="TIME", help="How long to wait.")] = "60s",
    every: Annotated[str, Option("--every", metavar="TIME", help="Time between probes.")] = "1s",
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
) -> None:
    """Wait until tasks are ready, completed or gone. Exit 1 when the time is over or a task has failed.

    A task that may run on a host that does not answer is not gone.

    Examples:
        edgectl wait slam-robot1
        edgectl wait slam-robot1 slam-robot2 --for ready --timeout 2m
        edgectl wait map-merge --for completed --timeout 2s
        edgectl wait slam-robot1 --for gone --timeout 2s
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.usecases.wait import wait_for_tasks
    from edgectl.views.wait import WaitView, describe_progress

    def report(progress: "TaskProgress", seconds: float) -> None:
        if output is OutputFormat.TABLE:
            console.print_message(f"{describe_progress(progress)} after {seconds:.1f} s")

    limit, period = parse_duration_option(timeout, "--timeout"), parse_every_option(every)
    fleet = build_fleet(load_inputs(inventory, tasks))
    chosen = select_task_names(names or (), selector, fleet.tasks)
    with catch_stop_signals(period) as end:
        stopped = False

        def pause() -> bool:
            nonlocal stopped
            stopped = end()
            return stopped

        found = wait_for_tasks(fleet, chosen, awaited, timeout_s=limit, pause=pause, report=report)
    console.print_view(WaitView(found, awaited), output)
    raise Exit(exit_codes.of_wait(found, interrupted=stopped))
