# SPDX-License-Identifier: Apache-2.0
"""apply command."""

import dataclasses
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit

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
    change: options.ChangeOptions,
    overrides: options.PlanPolicyOptions,
    limits: options.PlanFilterOptions,
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
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.apply import RECHECK_WINDOW_S, apply_saved_plan, plan_and_apply
    from edgectl.usecases.given_up import take_given_up_reminders

    asked = apply_session.check_can_confirm(asked=plan is None and not change.yes and not change.dry_run)
    fleet = build_fleet(load_inputs(inventory, tasks, quiet=change.quiet), accept_new=accept_new)
    choose = policy_options.build_plan_filter(fleet.tasks, limits, quiet=change.quiet)
    attended = policy_options.is_interactive()
    how = policy_options.policy_from_options(fleet, overrides, attended=attended)
    saved = policy_options.load_saved_plan(plan, overrides, limits)
    policy_options.require_solver(how if saved is None else saved.policy)
    if change.dry_run:
        raise Exit(apply_session.print_dry_run(fleet, how, saved, choose, output))
    with apply_session.open_apply_session(
        quiet=change.quiet, output=output, asked=asked, fleet=fleet.inventory.fleet
    ) as act:
        chosen = act.options_from(change, choose)
        if not attended:
            chosen = dataclasses.replace(chosen, recheck_window=RECHECK_WINDOW_S)
        applied = (
            plan_and_apply(fleet, how, act.confirm, chosen)
            if saved is None
            else apply_saved_plan(fleet, saved, chosen)
        )
    code = exit_codes.of_applied(applied, detailed=detailed, allow_unreachable=allow_unreachable)
    act.report(applied, code)
    if change.quiet:
        for reminder in take_given_up_reminders(fleet, applied.plan):
            console.print_message(reminder)
    raise Exit(exit_codes.worsen_if_given_up(code, applied.plan))
