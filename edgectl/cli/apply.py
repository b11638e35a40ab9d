"""apply."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import exits, options
from edgectl.cli.inputs import load
from edgectl.views.form import Form


def apply_command(
    *,
    plan: Annotated[
        Path | None, Argument(metavar="[PLAN]", help="Saved by edgectl plan --out; carried out unasked.", show_default=False)
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
    weights: options.WeightsOption = None,
    policy: options.PolicyOption = None,
    best_effort: options.BestEffortOption = False,
    full: options.FullOption = False,
    without: options.WithoutOption = None,
    target: options.TargetOption = None,
    selector: options.SelectorOption = None,
    detailed: options.DetailedOption = False,
    allow_unreachable: options.AllowOption = False,
    accept_new: options.AcceptOption = False,
) -> None:
    """Make reality match: plan, ask, then start, stop and move tasks; or carry out a saved plan, once, if nothing moved since.

    Examples:
        edgectl apply
        edgectl apply --yes --quiet
        edgectl apply --dry-run
        edgectl apply next.plan
    """
    from edgectl.cli import acting, decide
    from edgectl.cli.reach import reach, seconds
    from edgectl.usecases.apply import apply, apply_saved

    asked = acting.answerable(asked=plan is None and not yes and not dry_run)
    fleet = reach(load(inventory, tasks, quiet=quiet), accept_new=accept_new)
    choose = decide.chooser(fleet.tasks, target, selector, quiet=quiet)
    how = decide.policy_of(
        fleet, weights=weights, policy=policy, without=without, best_effort=best_effort, full=full, attended=decide.interactive()
    )
    saved = decide.saved(plan, weights, policy, without, target, selector, best_effort or full)
    if dry_run:
        raise Exit(acting.dry_run(fleet, how, saved, choose, output))
    with acting.session(quiet=quiet, output=output, asked=asked) as act:
        chosen = act.options(
            lock_timeout=seconds(lock_timeout, "--lock-timeout"), max_parallel=max_parallel, fail_fast=fail_fast, choose=choose
        )
        applied = apply(fleet, how, act.confirm, chosen) if saved is None else apply_saved(fleet, saved, chosen)
    code = exits.of_applied(applied, detailed=detailed, allow_unreachable=allow_unreachable)
    act.report(applied, code)
    raise Exit(code)
