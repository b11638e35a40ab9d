"""replay."""

import time
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from edgectl.cli import console, options
from edgectl.cli.user_files import load_inputs
from edgectl.views.output_format import OutputFormat


def replay_command(
    *,
    files: Annotated[
        list[Path] | None, Argument(metavar="[PATH]...", help="Snapshot files, or directories of them.")
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FieldsOutput = OutputFormat.TABLE,
    policies: options.PoliciesOption = "utility",
    weights: options.WeightsListOption = None,
    margin: Annotated[
        str | None, Option("--margin", metavar="LIST", help="Move margins, such as 0,0.1.")
    ] = None,
    since: Annotated[str, Option("--since", metavar="TIME", help="How much of the history.")] = "24h",
) -> None:
    """Decide recorded snapshots again under other rules, side by side: handoffs, unplaced tasks, utilisation.

    Without a PATH the fleet's own history is taken. Open loop: what the tasks used stays as it was recorded.

    Examples:
        edgectl replay --policy paper,utility
        edgectl replay --weights cpu,memory,network,all --since 7d
        edgectl replay now.json --margin 0,0.1 -o json
    """
    from edgectl.cli.connect import build_fleet, build_offline_fleet, parse_duration_option
    from edgectl.config.documents import load_snapshots
    from edgectl.experiments.commands.scheme_options import parse_margins, parse_schemes
    from edgectl.experiments.recorded_snapshots import read_recorded_snapshots, replay_schemes

    loaded = load_inputs(inventory, tasks)
    chosen = parse_schemes(loaded.tasks.policy, policies, weights, parse_margins(margin))
    fleet = build_offline_fleet(loaded) if files else build_fleet(loaded)
    snapshots = (
        load_snapshots(files)
        if files
        else read_recorded_snapshots(fleet, time.time() - parse_duration_option(since, "--since"))
    )
    if not snapshots:
        console.print_message("nothing is recorded in this time; every edgectl probe, plan and apply records")
    console.print_view(output, "replayed", replay_schemes(fleet, snapshots, chosen))
