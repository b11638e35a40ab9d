"""probe."""

from pathlib import Path
from typing import Annotated

from typer import Exit, Option

from edgectl.cli import console, exits, options
from edgectl.cli.inputs import load, save
from edgectl.views.form import Form


def probe_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.FleetOutput = Form.TABLE,
    out: Annotated[Path | None, Option("--out", metavar="FILE", help="Save the snapshot for edgectl plan --snapshot.")] = None,
    window: options.WindowOption = "0.5s",
    timeout: options.TimeoutOption = "15s",
    bandwidth: Annotated[bool, Option("--bandwidth", help="First measure each link by sending for 2 s.")] = False,
    accept_new: options.AcceptOption = False,
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Measure every host, every link and every task. Nothing is changed.

    Examples:
        edgectl probe
        edgectl probe -o wide --window 2s
        edgectl probe --out now.json
    """
    from edgectl.cli.reach import reach, seconds
    from edgectl.gateway.collect import ProbeOptions
    from edgectl.usecases.probe import measure_links, probe
    from edgectl.views.progress import probing

    fleet = reach(load(inventory, tasks), accept_new=accept_new)
    links = measure_links(fleet) if bandwidth else ()
    with probing(len(fleet.inventory.hosts)) as heard:
        how = ProbeOptions(window=seconds(window, "--window"), timeout=seconds(timeout, "--timeout"), on_host=heard)
        snapshot = probe(fleet, how)
    if out is not None:
        save(out, console.rendered(Form.JSON, "snapshot", snapshot))
    console.show(output, "bandwidth", snapshot, links) if bandwidth else console.show(output, "snapshot", snapshot)
    raise Exit(exits.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable))
