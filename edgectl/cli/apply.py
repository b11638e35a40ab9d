"""apply command."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat


def apply_command(
    *,
    plan: Annotated[
        Path | None,
        Argument(metavar="[PLAN]", help="Saved by plan --out; applied without asking.", show_default=False),
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    yes: options.YesOption = False,
    quiet: options.QuietOption = False,
    dry_run: Annotated[bool, Option("--dry-run", help="Only print the exact remote commands.")] = False,
    max_parallel: options.MaxParallelOption = 16,
    fail_fast: options.FailFastOption = False,
    lock_timeout: options.LockTimeoutOption = None,
    weights: options.WeightsOption = None,
    policy: options.PolicyOption = None,
    best_effort: options.BestEffortOption = False,
    prune: options.PruneOption = False,
    full: options.FullOption = False,
    without: options.WithoutOption = None,
    target: options.TargetOption = None,
    selector: options.SelectorOption = None,
    detailed: options.DetailedExitcodeOption = False,
    allow_unreachable: options.AllowUnreachableOption = False,
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Start, stop and move tasks to match the plan; or apply a saved plan, once, if nothing changed since.

    Examples:
        edgectl apply
        edgectl apply --yes --quiet
        edgectl apply --dry-run
        edgectl apply next.plan
    """
    from edgectl.cli import apply_session, policy_options
    from edgectl.cli.connect import build_fleet, parse_lock_timeout
    from edgectl.usecases.apply import apply_saved_plan, plan_and_apply
    from edgectl.usecases.given_up import take_given_up_reminders

    asked = apply_session.check_can_confirm(asked=plan is None and not yes and not dry_run)
    fleet = build_fleet(load_inputs(inventory, tasks, quiet=quiet), accept_new=accept_new)
    choose = policy_options.build_plan_filter(fleet.tasks, target, selector, quiet=quiet)
    how = policy_options.policy_from_options(
        fleet,
        weights=weights,
        policy=policy,
        without=without,
        best_effort=best_effort,
        full=full,
        prune=prune,
        attended=policy_options.is_interactive(),
    )
    saved = policy_options.load_saved_plan(
        plan, weights, policy, without, target, selector, best_effort or full or prune
    )
    if dry_run:
        raise Exit(apply_session.print_dry_run(fleet, how, saved, choose, output))
    with apply_session.open_apply_session(quiet=quiet, output=output, asked=asked) as act:
        chosen = act.options(
            lock_timeout=parse_lock_timeout(lock_timeout),
            max_parallel=max_parallel,
            fail_fast=fail_fast,
            choose=choose,
        )
        applied = (
            plan_and_apply(fleet, how, act.confirm, chosen)
            if saved is None
            else apply_saved_plan(fleet, saved, chosen)
        )
    code = exit_codes.of_applied(applied, detailed=detailed, allow_unreachable=allow_unreachable)
    act.report(applied, code)
    if quiet:
        for reminder in take_given_up_reminders(fleet, applied.plan):
            console.print_message(reminder)
    raise Exit(exit_codes.worsen_if_given_up(code, applied.plan))
