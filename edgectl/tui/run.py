"""The live view over a real fleet."""

import dataclasses
import sys
from collections.abc import Callable, Iterator

from edgectl.gateway.collect import ProbeOptions
from edgectl.tui.app import Fleetwork, Said, Top
from edgectl.tui.rows import Frame
from edgectl.usecases import look, marks
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.logs import logs
from edgectl.views.spark import SAMPLES
from edgectl.views.text import look_of
from edgectl.views.top import by_host, by_task

_TAIL = 200


def run(fleet: Fleet, *, every: float = 5.0, readonly: bool = False, first: str = "hosts", options: ProbeOptions | None = None) -> None:
    """Show the fleet until q, Ctrl-C or SIGTERM; it is looked at every ``every`` seconds. ``readonly``: hosts cannot be cordoned.

    ``first``: the table that has the keys at the beginning. Standard output must be a terminal.
    """
    app: Top

    def warn(text: str) -> None:
        app.post_message(Said(f"warning: {text}"))

    work = fleetwork(dataclasses.replace(fleet, warn=warn), readonly=readonly, options=options)
    app = Top(work, every=every, first=first, unicode=look_of(sys.stdout).unicode)
    app.run()


def fleetwork(fleet: Fleet, *, readonly: bool = False, options: ProbeOptions | None = None) -> Fleetwork:
    """What the view may ask of a fleet."""

    def frames(told_to_end: Callable[[], bool]) -> Iterator[Frame]:
        for snapshot in look.looks(fleet, told_to_end, options):
            yield Frame(
                snapshot=snapshot,
                inventory=fleet.inventory,
                tasks=fleet.tasks,
                host_points=by_host(look.host_history(fleet, SAMPLES)),
                task_points=by_task(look.task_history(fleet, SAMPLES)),
            )

    def cordon(host: str, close: bool) -> None:  # noqa: FBT001
        (marks.cordon if close else marks.uncordon)(fleet, [host])

    return Fleetwork(frames=frames, logs=lambda task: logs(fleet, task, tail=_TAIL), cordon=None if readonly else cordon)
