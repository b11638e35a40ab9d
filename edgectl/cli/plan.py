"""plan."""

from typer import Exit

from edgectl.cli import console, exits, options
from edgectl.cli.inputs import load, save
from edgectl.views.form import Form


def plan_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.PlanOutput = Form.TABLE,
    snapshot: options.SnapshotOption = None,
    out: options.OutOption = None,
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
    """Rank the hosts for every task by utility, and show what would be done and why. Nothing is changed.

    Examples:
        edgectl plan
        edgectl plan -o wide --weights network
        edgectl plan --out next.plan
        edgectl plan --without edge2 --detailed-exitcode
    """
    from edgectl.cli.decide import chooser, policy_of
    from edgectl.cli.reach import offline, reach
    from edgectl.config.documents import load_snapshot
    from edgectl.usecases.plan import plan

    loaded = load(inventory, tasks)
    choose = chooser(loaded.tasks, target, selector)
    fleet = offline(loaded) if snapshot else reach(loaded, accept_new=accept_new)
    how = policy_of(fleet, weights=weights, policy=policy, without=without, best_effort=best_effort, full=full)
    result = choose(plan(fleet, how, snapshot=load_snapshot(snapshot) if snapshot else None))
    if out is not None:
        save(out, console.rendered(Form.JSON, "plan", result))
        console.tell(f"saved {out}; carry it out with: edgectl apply {out}")
    console.show(output, "plan", result)
    raise Exit(exits.of_plan(result, detailed=detailed, allow_unreachable=allow_unreachable))
