# SPDX-License-Identifier: Apache-2.0
"""graph command."""

from typer import Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat


def graph_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.GraphOutput = OutputFormat.MERMAID,
    snapshot: options.SnapshotOption = None,
    weights: options.WeightsOption = None,
    policy: options.PolicyOption = None,
    without: options.WithoutOption = None,
    allow_unreachable: options.AllowUnreachableOption = False,
    accept_new: options.AcceptNewOption = False,
) -> None:
    """Export the task graph with the hosts of the plan as Mermaid or DOT, or as data.

    Examples:
        edgectl graph
        edgectl graph -o dot
        edgectl graph --without edge2
    """
    from edgectl.cli.connect import build_fleet, build_offline_fleet
    from edgectl.cli.policy_options import policy_from_options
    from edgectl.config.documents import load_snapshot
    from edgectl.usecases.plan import is_what_if, make_plan
    from edgectl.views.graph import TaskGraphView, build_task_graph

    loaded = load_inputs(inventory, tasks)
    fleet = build_offline_fleet(loaded) if snapshot else build_fleet(loaded, accept_new=accept_new)
    overrides = options.PolicyOptions(weights=weights, policy=policy, without=without)
    how = policy_from_options(fleet, overrides)
    made = make_plan(
        fleet,
        how,
        snapshot=load_snapshot(snapshot) if snapshot else None,
        recorded=not is_what_if(fleet, how),
    )
    view = TaskGraphView(made, loaded.tasks)
    if output in (OutputFormat.MERMAID, OutputFormat.DOT):
        drawn = build_task_graph(made, loaded.tasks)
        console.print_text(drawn.mermaid() if output is OutputFormat.MERMAID else drawn.dot())
        console.print_notes(view.notes())
    else:
        console.print_view(view, output)
    raise Exit(exit_codes.of_plan(made, detailed=False, allow_unreachable=allow_unreachable))
