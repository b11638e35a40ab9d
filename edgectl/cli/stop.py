# SPDX-License-Identifier: Apache-2.0
"""stop, start and restart commands."""

from typing import Annotated

from typer import Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.task_names import select_task_names
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode, UsageError
from edgectl.model.plan import Action
from edgectl.views.output_format import OutputFormat


def stop_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    every: Annotated[bool, Option("--all", help="Every running task on every host.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    yes: options.YesOption = False,
    dry_run: options.DryRunOption = False,
    max_parallel: options.MaxParallelOption = 16,
    fail_fast: options.FailFastOption = False,
    lock_timeout: options.LockTimeoutOption = None,
) -> None:
    """Stop tasks and verify that they are gone. The next apply starts them again, unless they are marked
    done.

    Examples:
        edgectl stop slam-robot1 --yes
        edgectl stop --all --yes
        edgectl stop slam-robot1 --dry-run
    """
    from edgectl.cli import apply_session
    from edgectl.cli.connect import build_fleet, parse_lock_timeout
    from edgectl.usecases.stop import stop_tasks
    from edgectl.views.other_tasks import describe_absence

    if (bool(names) or selector is not None) == every:
        raise UsageError("name tasks, or pass -l LABELS or --all", hint="list running tasks: edgectl status")
    first = "check first: edgectl stop --dry-run"
    asked = apply_session.check_can_confirm(asked=not (yes or dry_run), first=first)
    fleet = build_fleet(load_inputs(inventory, tasks))
    chosen = () if every else select_task_names(names or (), selector, fleet.tasks)
    with apply_session.open_apply_session(
        quiet=False, output=output, asked=asked, dry_run=dry_run, fleet=fleet.inventory.fleet
    ) as act:
        how = act.options(
            lock_timeout=parse_lock_timeout(lock_timeout),
            max_parallel=max_parallel,
            fail_fast=fail_fast,
        )
        applied = stop_tasks(fleet, chosen or None, act.confirm, how)
    if dry_run:
        apply_session.print_requests(fleet, applied.plan, output)
    act.report(applied)
    planned = {step.task for step in applied.plan.steps}
    for name in dict.fromkeys(chosen):
        if name not in planned:
            console.print_message(describe_absence(name, applied.plan.snapshot))
    raise Exit(exit_codes.of_named(applied, chosen or None))


def start_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    yes: options.YesOption = False,
    dry_run: options.DryRunOption = False,
    lock_timeout: options.LockTimeoutOption = None,
) -> None:
    """Start stopped tasks where a plan of now places them; also those that failed, completed or are done.

    What runs already is left alone. Exit 4 if a task has no place.

    Examples:
        edgectl start slam-robot1 --yes
        edgectl start slam-robot1 --dry-run
    """
    from edgectl.cli import apply_session
    from edgectl.cli.connect import build_fleet, parse_lock_timeout
    from edgectl.usecases.stop import start_tasks

    first = "check first: edgectl start --dry-run"
    asked = apply_session.check_can_confirm(asked=not (yes or dry_run), first=first)
    loaded = load_inputs(inventory, tasks)
    fleet = build_fleet(loaded)
    chosen = select_task_names(names or (), selector, fleet.tasks)
    with apply_session.open_apply_session(
        quiet=False, output=output, asked=asked, dry_run=dry_run, fleet=fleet.inventory.fleet
    ) as act:
        applied = start_tasks(
            fleet,
            loaded.tasks.policy,
            chosen,
            act.confirm,
            act.options(lock_timeout=parse_lock_timeout(lock_timeout)),
        )
    if dry_run:
        raise Exit(apply_session.print_requests(fleet, applied.plan, output))
    act.report(applied)
    without = any(step.action in (Action.UNPLACED, Action.HOLD) for step in applied.plan.steps)
    raise Exit(exit_codes.of_named(applied, chosen) or (ExitCode.PARTLY if without else ExitCode.DONE))


def restart_command(
    *,
    names: options.TasksArgument = None,
    selector: options.SelectorOption = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    yes: options.YesOption = False,
    dry_run: options.DryRunOption = False,
    lock_timeout: options.LockTimeoutOption = None,
) -> None:
    """Stop tasks and start each again on its host; or start those that failed for good.

    Examples:
        edgectl restart slam-robot1 --yes
        edgectl restart slam-robot1 --yes -o json
    """
    from edgectl.cli import apply_session
    from edgectl.cli.connect import build_fleet, parse_lock_timeout
    from edgectl.usecases.stop import restart_tasks

    first = "check first: edgectl restart --dry-run"
    asked = apply_session.check_can_confirm(asked=not (yes or dry_run), first=first)
    fleet = build_fleet(load_inputs(inventory, tasks))
    chosen = select_task_names(names or (), selector, fleet.tasks)
    with apply_session.open_apply_session(
        quiet=False, output=output, asked=asked, dry_run=dry_run, fleet=fleet.inventory.fleet
    ) as act:
        applied = restart_tasks(
            fleet,
            chosen,
            act.confirm,
            act.options(lock_timeout=parse_lock_timeout(lock_timeout)),
        )
    if dry_run:
        raise Exit(apply_session.print_requests(fleet, applied.plan, output))
    act.report(applied)
    raise Exit(exit_codes.of_named(applied, chosen))
