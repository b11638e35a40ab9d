# SPDX-License-Identifier: Apache-2.0
"""diff command."""

from typer import Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs
from edgectl.errors import ExitCode
from edgectl.views.output_format import OutputFormat


def diff_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.NamedOutput = OutputFormat.TABLE,
    snapshot: options.SnapshotOption = None,
    overrides: options.PlanPolicyOptions,
    limits: options.PlanFilterOptions,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show what apply would change: what runs now, and what would run.

    Exit code 0: no changes, 1: changes, above 1: an error (4: a host did not answer).

    Examples:
        edgectl diff
        edgectl diff --target slam-robot1 -o json
    """
    from edgectl.cli.connect import build_fleet, build_offline_fleet
    from edgectl.cli.policy_options import build_plan_filter, policy_from_options, require_solver
    from edgectl.config.documents import load_snapshot
    from edgectl.usecases.plan import make_plan
    from edgectl.views.diff import DiffView

    loaded = load_inputs(inventory, tasks)
    choose = build_plan_filter(loaded.tasks, limits)
    fleet = build_offline_fleet(loaded) if snapshot else build_fleet(loaded)
    how = policy_from_options(fleet, overrides)
    require_solver(how)
    seen = load_snapshot(snapshot) if snapshot else None
    plan = choose(make_plan(fleet, how, snapshot=seen, recorded=False))
    console.print_view(DiffView(plan), output, fleet=fleet.inventory.fleet)
    code = exit_codes.of_plan(plan, detailed=False, allow_unreachable=allow_unreachable)
    raise Exit(code or (ExitCode.FAILED if plan.changes else ExitCode.DONE))
