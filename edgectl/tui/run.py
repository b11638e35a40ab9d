# SPDX-License-Identifier: Apache-2.0
"""The live view over a real fleet."""

import dataclasses
import sys
from collections.abc import Callable, Iterator

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.tui.app import FleetBackend, NoteChanged, TopApp
from edgectl.tui.rows import Frame
from edgectl.usecases import operator_marks, status
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.logs import read_log
from edgectl.views.sparkline import SPARKLINE_SAMPLES
from edgectl.views.text import detect_render_options
from edgectl.views.top_hosts import group_points_by_host
from edgectl.views.top_tasks import group_points_by_task

_LOG_TAIL_LINES = 200


def run_top_view(
    fleet: Fleet,
    *,
    every: float = 5.0,
    readonly: bool = False,
    first: str = "hosts",
    options: ProbeOptions | None = None,
) -> None:
    """Show the fleet until q, Ctrl-C or SIGTERM, probed every ``every`` seconds.

    ``readonly``: hosts cannot be cordoned.

    ``first``: the table that has the focus at the beginning. Standard output must be a terminal.
    """
    app: TopApp

    def warn(text: str) -> None:
        app.post_message(NoteChanged(f"warning: {text}"))

    work = build_fleet_backend(dataclasses.replace(fleet, warn=warn), readonly=readonly, options=options)
    app = TopApp(work, every=every, first=first, unicode=detect_render_options(sys.stdout).unicode)
    app.run()


def build_fleet_backend(
    fleet: Fleet, *, readonly: bool = False, options: ProbeOptions | None = None
) -> FleetBackend:
    """Operations of the view on a fleet."""

    def frames(should_stop: Callable[[], bool]) -> Iterator[Frame]:
        for snapshot in status.probe_repeatedly(fleet, should_stop, options):
            yield Frame(
                snapshot=snapshot,
                inventory=fleet.inventory,
                tasks=fleet.tasks,
                host_points=group_points_by_host(status.load_host_points(fleet, SPARKLINE_SAMPLES)),
                task_points=group_points_by_task(status.load_task_points(fleet, SPARKLINE_SAMPLES)),
            )

    def cordon(host: str, close: bool) -> None:  # noqa: FBT001
        (operator_marks.cordon_hosts if close else operator_marks.uncordon_hosts)(fleet, [host])

    return FleetBackend(
        frames=frames,
        logs=lambda task: read_log(fleet, task, tail=_LOG_TAIL_LINES),
        cordon=None if readonly else cordon,
    )
