"""stop and restart."""

from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import exits, options
from edgectl.cli.complete import tasks as task_names
from edgectl.cli.inputs import load
from edgectl.errors import UsageError
from edgectl.views.form import Form


def stop_command(
    *,
    names: Annotated[
        list[str] | None, Argument(metavar="[TASK...]", autocompletion=task_names, help="Names of tasks.", show_default=False)
    ] = None,
    every: Annotated[bool, Option("--all", help="Every task that runs, wherever it runs.")] = False,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ResultOutput = Form.TABLE,
    yes: options.YesOption = False,
    max_parallel: options.ParallelOption = 16,
    fail_fast: options.FailFastOption = False,
    lock_timeout: options.LockOption = "0s",
) -> None:
    """Stop tasks and prove that they are gone. The next apply starts them again, unless edgectl done says otherwise.

    Examples:
        edgectl stop slam-robot1 --yes
        edgectl stop --all --yes
    """
    from edgectl.cli import acting
    from edgectl.cli.reach import reach, seconds
    from edgectl.usecases.stop import stop

    if bool(names) == every:
        raise UsageError("name tasks, or pass --all", hint="edgectl status lists what runs")
    acting.answerable(asked=not yes)
    fleet = reach(load(inventory, tasks))
    with acting.session(quiet=False, output=output, asked=not yes) as act:
        chosen = act.options(lock_timeout=seconds(lock_timeout, "--lock-timeout"), max_parallel=max_parallel, fail_fast=fail_fast)
        applied = stop(fleet, names or None, act.confirm, chosen)
    act.report(applied)
    raise Exit(exits.of_applied(applied))


def restart_command(
    *,
    task: options.TaskArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ResultOutput = Form.TABLE,
    yes: options.YesOption = False,
    lock_timeout: options.LockOption = "0s",
) -> None:
    """Stop a task and start it again on the host where it runs; or start one that was given up (status says so).

    Examples:
        edgectl restart slam-robot1 --yes
        edgectl restart slam-robot1 --yes -o json
    """
    from edgectl.cli import acting
    from edgectl.cli.reach import reach, seconds
    from edgectl.usecases.stop import restart

    acting.answerable(asked=not yes)
    fleet = reach(load(inventory, tasks))
    with acting.session(quiet=False, output=output, asked=not yes) as act:
        applied = restart(fleet, task, act.confirm, act.options(lock_timeout=seconds(lock_timeout, "--lock-timeout")))
    act.report(applied)
    raise Exit(exits.of_applied(applied))
