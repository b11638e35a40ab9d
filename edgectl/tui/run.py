# SPDX-License-Identifier: Apache-2.0
"""The live view over a real fleet."""

import dataclasses
import sys
from collections.abc import Callable, Iterator

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.result import Results
from edgectl.tui.app import TopApp
from edgectl.tui.backend import FleetBackend, NoteChanged
from edgectl.tui.rows import Frame
from edgectl.usecases import operator_marks, status
from edgectl.usecases.drain import drain_hosts
from edgectl.usecases.explain import compute_noise_by_host, explain_placement
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.logs import read_log
from edgectl.usecases.plan import make_plan
from edgectl.usecases.stop import restart_tasks
from edgectl.views.explanation import ExplanationView
from edgectl.views.notes import list_unreachable_notes
from edgectl.views.sparkline import SPARKLINE_SAMPLES
from edgectl.views.text import RenderOptions, detect_render_options
from edgectl.views.top_hosts import group_points_by_host
from edgectl.views.top_tasks import group_points_by_task

_LOG_TAIL_LINES = 200
# Of an explanation, inside the frame of its screen on 80 columns.
_WIDTH = 68


def run_top_view(
    fleet: Fleet,
    *,
    every: float = 5.0,
    readonly: bool = False,
    first: str = "hosts",
    options: ProbeOptions | None = None,
    open_shell: Callable[[str], int] | None = None,
) -> None:
    """Show the fleet until q, Ctrl-C or SIGTERM, probed every ``every`` seconds.

    ``readonly``: nothing can be changed. ``open_shell`` opens a shell on a host. ``first``: the table that
    has the focus at the beginning. Standard output must be a terminal.
    """
    app: TopApp

    def warn(text: str) -> None:
        app.post_message(NoteChanged(f"warning: {text}"))

    work = build_fleet_backend(
        dataclasses.replace(fleet, warn=warn), readonly=readonly, options=options, open_shell=open_shell
    )
    app = TopApp(work, every=every, first=first, unicode=detect_render_options(sys.stdout).unicode)
    app.run()


def build_fleet_backend(
    fleet: Fleet,
    *,
    readonly: bool = False,
    options: ProbeOptions | None = None,
    open_shell: Callable[[str], int] | None = None,
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

    def explain(task: str) -> str:
        if task not in fleet.tasks.tasks:
            return f"{task} is in no task file"
        plan = make_plan(fleet, fleet.tasks.policy, options=options, recorded=False)
        step = next(step for step in plan.steps if step.task == task)
        found = explain_placement(fleet, plan, task, compute_noise_by_host(fleet))
        unanswered = list_unreachable_notes(plan.snapshot)
        return ExplanationView(step, found, unanswered, plan.snapshot.manager).table(
            RenderOptions(width=_WIDTH)
        )

    def restart(task: str) -> str:
        return _describe_outcome(f"{task} restarted", restart_tasks(fleet, [task]).results)

    def drain(host: str) -> str:
        drained = drain_hosts(fleet, fleet.tasks.policy, [host])
        left = ", ".join(task for task, _ in drained.left)
        if left:
            return f"{host} is cordoned; still there: {left}"
        return _describe_outcome(f"{host} drained", drained.applied.results)

    return FleetBackend(
        frames=frames,
        logs=lambda task: read_log(fleet, task, tail=_LOG_TAIL_LINES),
        explain=explain,
        cordon=None if readonly else cordon,
        restart=None if readonly else restart,
        drain=None if readonly else drain,
        open_shell=None if readonly else open_shell,
    )


def _describe_outcome(done: str, results: Results | None) -> str:
    """What came of a change: the first action that failed, if one did."""
    failed = next((each for each in results.actions if each.error), None) if results is not None else None
    return done if failed is None else f"{failed.task}: {failed.error}"
