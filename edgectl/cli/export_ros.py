# SPDX-License-Identifier: Apache-2.0
"""export ros command."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from edgectl.cli import console, options
from edgectl.cli.completion import complete_hosts
from edgectl.cli.signals import parse_every_option, return_on_signal
from edgectl.cli.user_files import load_inputs

if TYPE_CHECKING:
    from edgectl.formats.document import Document
    from edgectl.model.snapshot import Snapshot
    from edgectl.usecases.fleet import Fleet

_STALE_S, _STALE_PERIODS = 15.0, 3.0


def export_ros_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    setup: Annotated[
        list[Path] | None,
        Option("--setup", metavar="FILE", help="Set-up file of this machine; default: those of ros:."),
    ] = None,
    host: Annotated[
        str | None,
        Option("--host", metavar="HOST", autocompletion=complete_hosts, help="Whose ros: is used."),
    ] = None,
    every: Annotated[str, Option("--every", metavar="TIME", help="Time between probes.")] = "2s",
    timeout: options.TimeoutOption = "8s",
) -> None:
    """Publish the state of the fleet in ROS, once a second, until Ctrl-C. Nothing is changed.

    /diagnostics has a status of the fleet, each host and each task; /edgectl/status has the document of
    edgectl status -o json as a string. ROS 1 or 2 as ros: in the inventory states, else as this shell.

    Examples:
        edgectl export ros
        edgectl export ros --setup /opt/ros/humble/setup.bash
    """
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.export.ros_gateway import STATUS_TOPIC, run_ros_node
    from edgectl.gateway.host_probe import ProbeOptions
    from edgectl.names import check_known_names
    from edgectl.usecases.ros_gateway import choose_ros_settings, publish_fleet
    from edgectl.usecases.scrape import keep_sessions_open

    fleet = build_fleet(load_inputs(inventory, tasks))
    known = fleet.inventory
    check_known_names([host] if host else [], known.hosts, "host")
    period = parse_every_option(every)
    how = ProbeOptions(timeout=parse_duration_option(timeout, "--timeout"))
    ros = choose_ros_settings(known.hosts, host)

    with (
        return_on_signal(),
        run_ros_node(
            known.fleet,
            ros,
            setup=[str(path) for path in setup or ()],
            peers=[each.host for each in known.robots],
            stale_s=max(_STALE_S, how.timeout + _STALE_PERIODS * period),
        ) as node,
        keep_sessions_open(fleet) as near,
    ):
        console.print_message(f"publishing /diagnostics and {STATUS_TOPIC}; press Ctrl-C to stop")
        publish_fleet(near, node, lambda seen: _encode_fleet(fleet, seen), options=how, every=period)


def _encode_fleet(fleet: "Fleet", seen: "Snapshot") -> "Document":
    """What is published of a probe: the diagnostics, and the document of ``edgectl status -o json``."""
    from edgectl.usecases.plan import find_fleet_shortages
    from edgectl.views.output import render_view
    from edgectl.views.output_format import OutputFormat
    from edgectl.views.ros_diagnostics import encode_diagnostics
    from edgectl.views.status import StatusView

    view = StatusView(seen, fleet.inventory, fleet.tasks, find_fleet_shortages(fleet, seen))
    return {
        "diagnostics": encode_diagnostics(seen, fleet.inventory, fleet.tasks),
        "status": render_view(view, OutputFormat.JSON),
    }
