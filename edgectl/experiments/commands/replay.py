# SPDX-License-Identifier: Apache-2.0
"""The command replay."""

import time
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from edgectl.cli import console, options
from edgectl.cli.user_files import load_inputs
from edgectl.experiments.commands.scheme_options import PoliciesOption, WeightsListOption
from edgectl.views.output_format import OutputFormat


def replay_command(
    *,
    files: Annotated[
        list[Path] | None, Argument(metavar="[PATH]...", help="Snapshot files, or directories of them.")
    ] = None,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.ItemOutput = OutputFormat.TABLE,
    policies: PoliciesOption = "utility",
    weights: WeightsListOption = None,
    margin: Annotated[
        str | None, Option("--margin", metavar="LIST", help="Move margins, such as 0,0.1.")
    ] = None,
    since: Annotated[str, Option("--since", metavar="TIME", help="Length of the history to replay.")] = "24h",
) -> None:
    """Re-run the scheduler on recorded snapshots under other policies and compare the results.

    The results are handoffs, unplaced tasks and utilisation. Without a PATH, the fleet's history is replayed.
    Open loop: the usage of tasks stays as recorded.

    Examples:
        edgectl replay --policy paper,utility
        edgectl replay --weights cpu,memory,network,all --since 7d
        edgectl replay now.json --margin 0,0.1 -o json
    """
    from edgectl.cli.connect import build_fleet, build_offline_fleet, parse_duration_option
    from edgectl.config.documents import load_snapshots
    from edgectl.experiments.commands.scheme_options import parse_margins, parse_schemes
    from edgectl.experiments.recorded_snapshots import read_recorded_snapshots, replay_schemes
    from edgectl.experiments.views.replay import ReplayView

    loaded = load_inputs(inventory, tasks)
    schemes = parse_schemes(loaded.tasks.policy, policies, weights, parse_margins(margin))
    fleet = build_offline_fleet(loaded) if files else build_fleet(loaded)
    snapshots = (
        load_snapshots(files)
        if files
        else read_recorded_snapshots(fleet, time.time() - parse_duration_option(since, "--since"))
    )
    if not snapshots:
        console.print_message(
            "no snapshots were recorded in this period; edgectl probe, plan and apply record them"
        )
    console.print_view(ReplayView(results=replay_schemes(fleet, snapshots, schemes)), output)
