"""plan command."""

from typer import Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs, save_file
from edgectl.views.output_format import OutputFormat


def plan_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.PlanOutput = OutputFormat.TABLE,
    snapshot: options.SnapshotOption = None,
    out: options.SavePlanOption = None,
    overrides: options.PlanPolicyOptions,
    limits: options.PlanFilterOptions,
    detailed: options.DetailedExitcodeOption = False,
    allow_unreachable: options.AllowUnreachableOption = False,
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Rank hosts for each task by utility and show the changes, with reasons. Nothing is changed.

    Examples:
        edgectl plan
        edgectl plan -o wide --weights network
        edgectl plan --out next.plan
        edgectl plan --without edge2 --detailed-exitcode
    """
    from edgectl.cli.connect import build_fleet, build_offline_fleet
    from edgectl.cli.policy_options import build_plan_filter, policy_from_options, require_solver
    from edgectl.config.documents import load_snapshot
    from edgectl.usecases.plan import is_what_if, make_plan
    from edgectl.views.output import render_view
    from edgectl.views.plan import PlanView

    loaded = load_inputs(inventory, tasks)
    choose = build_plan_filter(loaded.tasks, limits)
    fleet = build_offline_fleet(loaded) if snapshot else build_fleet(loaded, accept_new=accept_new)
    how = policy_from_options(fleet, overrides)
    require_solver(how)
    result = choose(
        make_plan(
            fleet,
            how,
            snapshot=load_snapshot(snapshot) if snapshot else None,
            recorded=not is_what_if(fleet, how),
        )
    )
    view = PlanView(result)
    if out is not None:
        save_file(out, render_view(view, OutputFormat.JSON))
        console.print_message(f"saved {out}; apply it with: edgectl apply {out}")
    console.print_view(view, output)
    raise Exit(exit_codes.of_plan(result, detailed=detailed, allow_unreachable=allow_unreachable))
