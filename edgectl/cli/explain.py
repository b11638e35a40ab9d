"""explain command."""

from typer import Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs
from edgectl.names import check_known_names
from edgectl.views.output_format import OutputFormat


def explain_command(
    *,
    task: options.TaskArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.WideOutput = OutputFormat.TABLE,
    snapshot: options.SnapshotOption = None,
    weights: options.WeightsOption = None,
    policy: options.PolicyOption = None,
    without: options.WithoutOption = None,
    allow_unreachable: options.AllowUnreachableOption = False,
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Explain a placement: the contribution of each term, and the smallest changes that would change the
    host.

    Each change is planned again: a task that would move before is named. A lead below the variation of the
    measurements is called fragile.

    Examples:
        edgectl explain slam-robot1
        edgectl explain slam-robot1 -o wide
        edgectl explain slam-robot1 --weights network -o json
    """
    from edgectl.cli.connect import build_fleet, build_offline_fleet
    from edgectl.cli.policy_options import policy_from_options
    from edgectl.config.documents import load_snapshot
    from edgectl.usecases.explain import compute_noise_by_host, explain_placement
    from edgectl.usecases.plan import is_what_if, make_plan
    from edgectl.views.explanation import ExplanationView
    from edgectl.views.plan_sections import list_lost_task_notes, list_slack_notes, list_unreachable_notes

    loaded = load_inputs(inventory, tasks)
    check_known_names([task], loaded.tasks.tasks, "task")
    fleet = build_offline_fleet(loaded) if snapshot else build_fleet(loaded, accept_new=accept_new)
    overrides = options.PolicyOptions(weights=weights, policy=policy, without=without)
    how = policy_from_options(fleet, overrides)
    made = make_plan(
        fleet,
        how,
        snapshot=load_snapshot(snapshot) if snapshot else None,
        recorded=not is_what_if(fleet, how),
    )
    found = explain_placement(fleet, made, task, None if snapshot else compute_noise_by_host(fleet))
    step = next(step for step in made.steps if step.task == task)
    console.print_view(
        ExplanationView(step, found, list_unreachable_notes(made.snapshot), made.snapshot.manager), output
    )
    console.print_notes(list_lost_task_notes(made.snapshot, {task}) + list_slack_notes(made, {task}))
    raise Exit(exit_codes.of_plan(made, detailed=False, allow_unreachable=allow_unreachable))
