"""replay."""

import time
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from edgectl.cli import console, options
from edgectl.cli.inputs import load
from edgectl.views.form import Form


def replay_command(
    *,
    files: Annotated[list[Path] | None, Argument(metavar="[PATH]...", help="Snapshot files, or directories of them.")] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FieldsOutput = Form.TABLE,
    policies: options.PoliciesOption = "utility",
    weights: options.WeightsListOption = None,
    margin: Annotated[str | None, Option("--margin", metavar="LIST", help="Move margins, such as 0,0.1.")] = None,
    since: Annotated[str, Option("--since", metavar="TIME", help="How much of the history.")] = "24h",
) -> None:
    """Decide recorded snapshots again under other rules, side by side: handoffs, unplaced tasks, utilisation.

    Without a PATH the fleet's own history is taken. Open loop: what the tasks used stays as it was recorded.

    Examples:
        edgectl replay --policy paper,utility
        edgectl replay --weights cpu,memory,network,all --since 7d
        edgectl replay now.json --margin 0,0.1 -o json
    """
    from edgectl.cli.compare import margins_of, variants_of
    from edgectl.cli.reach import offline, reach, seconds
    from edgectl.config.documents import load_snapshots
    from edgectl.usecases.replay import history, replay

    loaded = load(inventory, tasks)
    chosen = variants_of(loaded.tasks.policy, policies, weights, margins_of(margin))
    fleet = offline(loaded) if files else reach(loaded)
    snapshots = load_snapshots(files) if files else history(fleet, time.time() - seconds(since, "--since"))
    if not snapshots:
        console.tell("nothing is recorded in this time; every edgectl probe, plan and apply records")
    console.show(output, "replayed", replay(fleet, snapshots, chosen))
