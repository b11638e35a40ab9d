"""history, show and rollback."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, exits, options
from edgectl.cli.inputs import load
from edgectl.views.form import Form


def history_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ResultOutput = Form.TABLE,
) -> None:
    """List what was done to the fleet: each apply, stop, restart, drain and rollback, with who, when and how it ended.

    Examples:
        edgectl history
        edgectl history -o json
    """
    from edgectl.cli.reach import reach
    from edgectl.usecases.history import history

    console.show(output, "history", history(reach(load(inventory, tasks))))


def show_command(
    *,
    what: Annotated[str, Argument(metavar="REV|PLAN", help="A number of edgectl history, or a saved plan.", show_default=False)],
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.PlanOutput = Form.TABLE,
    detailed: options.DetailedOption = False,
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Print one revision (its actions, their phases and durations), or a saved plan. Nothing is contacted.

    Examples:
        edgectl show 1
        edgectl show next.plan
        edgectl show next.plan -o wide
    """
    from edgectl.cli.reach import reach
    from edgectl.config.documents import load_plan
    from edgectl.usecases.history import revision

    if what.isdecimal():
        console.show(output, "revision", revision(reach(load(inventory, tasks)), int(what)))
        return
    saved = load_plan(Path(what))
    console.show(output, "plan", saved)
    raise Exit(exits.of_plan(saved, detailed=detailed, allow_unreachable=allow_unreachable))


def rollback_command(
    *,
    revision: Annotated[
        int | None, Argument(metavar="[REV]", min=1, help="Of edgectl history; without it, undo the last one.", show_default=False)
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ResultOutput = Form.TABLE,
    yes: options.YesOption = False,
    quiet: options.QuietOption = False,
    dry_run: Annotated[bool, Option("--dry-run", help="Only print the exact remote commands.")] = False,
    max_parallel: options.ParallelOption = 16,
    fail_fast: options.FailFastOption = False,
    lock_timeout: options.LockOption = "0s",
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Plan towards where the tasks stood after a revision, ask, and carry it out. Commands and demands are those of today's files.

    Examples:
        edgectl rollback
        edgectl rollback 1 --yes
        edgectl rollback 1 --dry-run
    """
    from edgectl.cli import acting
    from edgectl.cli.reach import reach, seconds
    from edgectl.usecases.change import ApplyOptions
    from edgectl.usecases.history import rollback, rollback_plan
    from edgectl.usecases.plan import whole

    asked = acting.answerable(asked=not yes and not dry_run)
    fleet = reach(load(inventory, tasks))
    policy = fleet.tasks.policy
    if dry_run:
        raise Exit(acting.dry_run(fleet, policy, rollback_plan(fleet, policy, revision, ApplyOptions()), whole, output))
    with acting.session(quiet=quiet, output=output, asked=asked) as act:
        chosen = act.options(lock_timeout=seconds(lock_timeout, "--lock-timeout"), max_parallel=max_parallel, fail_fast=fail_fast)
        applied = rollback(fleet, policy, revision, act.confirm, chosen)
    code = exits.of_applied(applied, allow_unreachable=allow_unreachable)
    act.report(applied, code)
    raise Exit(code)
