"""explain."""

from edgectl.cli import console, options
from edgectl.cli.inputs import load
from edgectl.model.names import known
from edgectl.views.form import Form


def explain_command(
    *,
    task: options.TaskArgument,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ExplainOutput = Form.TABLE,
    snapshot: options.SnapshotOption = None,
    weights: options.WeightsOption = None,
    policy: options.PolicyOption = None,
    without: options.WithoutOption = None,
    accept_new: options.AcceptOption = False,
) -> None:
    """Say why a task goes where it goes: what each term adds, and the smallest changes that would send it elsewhere.

    All other tasks are taken to stay where they are. A lead below what the measurements vary by is called fragile.

    Examples:
        edgectl explain slam-robot1
        edgectl explain slam-robot1 -o wide
        edgectl explain slam-robot1 --weights network -o json
    """
    from edgectl.cli.decide import policy_of
    from edgectl.cli.reach import offline, reach
    from edgectl.config.documents import load_snapshot
    from edgectl.usecases.explain import explain, noise_of
    from edgectl.usecases.plan import plan

    loaded = load(inventory, tasks)
    known([task], loaded.tasks.tasks, "task")
    fleet = offline(loaded) if snapshot else reach(loaded, accept_new=accept_new)
    how = policy_of(fleet, weights=weights, policy=policy, without=without, best_effort=False, full=False)
    made = plan(fleet, how, snapshot=load_snapshot(snapshot) if snapshot else None)
    found = explain(fleet, made, task, None if snapshot else noise_of(fleet))
    console.show(output, "explanation", next(step for step in made.steps if step.task == task), found)
