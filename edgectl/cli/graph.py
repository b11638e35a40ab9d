"""graph."""

from edgectl.cli import console, options
from edgectl.cli.inputs import load
from edgectl.views.form import Form


def graph_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.GraphOutput = Form.MERMAID,
    snapshot: options.SnapshotOption = None,
    weights: options.WeightsOption = None,
    policy: options.PolicyOption = None,
    without: options.WithoutOption = None,
    accept_new: options.AcceptOption = False,
) -> None:
    """Draw the tasks, what they need, and the hosts on which the plan puts them.

    Examples:
        edgectl graph
        edgectl graph -o dot
        edgectl graph --without edge2
    """
    from edgectl.cli.decide import policy_of
    from edgectl.cli.reach import offline, reach
    from edgectl.config.documents import load_snapshot
    from edgectl.usecases.plan import plan

    loaded = load(inventory, tasks)
    fleet = offline(loaded) if snapshot else reach(loaded, accept_new=accept_new)
    how = policy_of(fleet, weights=weights, policy=policy, without=without, best_effort=False, full=False)
    console.show(output, "graph", plan(fleet, how, snapshot=load_snapshot(snapshot) if snapshot else None), loaded.tasks)
