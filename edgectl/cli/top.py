"""top hosts and top tasks."""

import dataclasses
import os
import signal
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from typer import Exit

from edgectl.cli import console, exits, options
from edgectl.cli.inputs import Loaded, load
from edgectl.cli.until import pause, told
from edgectl.errors import UsageError
from edgectl.model.names import either
from edgectl.views.form import Form

if TYPE_CHECKING:
    from edgectl.model.snapshot import Snapshot
    from edgectl.usecases.fleet import Fleet

# What a view is given of one look at the fleet.
Values = tuple[Any, ...]
_WATCHED = (Form.TABLE, Form.WIDE, Form.JSON)


def top_hosts_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.TopOutput = Form.TABLE,
    watch: options.WatchOption = False,
    every: options.EveryOption = "2s",
    interactive: options.InteractiveOption = False,
    readonly: options.ReadonlyOption = False,
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Show how much of its CPU, memory and busiest link each host uses, now and over its last 60 samples, whoever took them.

    A share above the limit of the inventory ends in "!". On a pipe there are numbers only; -w -o json is one object per line.

    Examples:
        edgectl top hosts
        edgectl top hosts -o wide
        edgectl top hosts -w --every 5s
        edgectl top hosts -w -o json
    """
    loaded, period = load(inventory, tasks), pause(every)
    if interactive:
        return _interact(loaded, period, readonly=readonly, first="hosts")
    raise Exit(_top(loaded, "top_hosts", output, period if watch else None, allow_unreachable=allow_unreachable))


def top_tasks_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.TopOutput = Form.TABLE,
    watch: options.WatchOption = False,
    every: options.EveryOption = "2s",
    interactive: options.InteractiveOption = False,
    readonly: options.ReadonlyOption = False,
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Show how much each task uses against its demand (OFF: use minus demand), now and over its last 60 samples, whoever took them.

    On a pipe there are numbers only; -w -o json is one object per line.

    Examples:
        edgectl top tasks -o wide
        edgectl top tasks -w
    """
    loaded, period = load(inventory, tasks), pause(every)
    if interactive:
        return _interact(loaded, period, readonly=readonly, first="tasks")
    raise Exit(_top(loaded, "top_tasks", output, period if watch else None, allow_unreachable=allow_unreachable))


def _top(loaded: Loaded, what: str, output: Form, every: float | None, *, allow_unreachable: bool) -> int:
    """Once, or with ``every`` again and again."""
    from edgectl.cli.reach import reach
    from edgectl.usecases.probe import probe

    fleet = reach(loaded)
    if every is None:
        snapshot = probe(fleet)
        console.show(output, what, *_values(fleet, what, snapshot))
        return exits.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable)
    if output not in _WATCHED:
        raise UsageError(f"no {output} form that goes on", hint=f"write -o {either(_WATCHED)}")
    _watch(fleet, what, output, every)
    return 0


def _values(fleet: "Fleet", what: str, snapshot: "Snapshot") -> Values:
    from edgectl.usecases.look import host_history, task_history
    from edgectl.views.spark import SAMPLES

    if what == "top_hosts":
        return (snapshot, fleet.inventory, host_history(fleet, SAMPLES))
    return (snapshot, fleet.inventory, fleet.tasks, task_history(fleet, SAMPLES))


def _watch(fleet: "Fleet", what: str, output: Form, every: float) -> None:
    """On a terminal in place, elsewhere one after the other, until Ctrl-C (or q)."""
    from edgectl.usecases.look import looks

    said: dict[str, None] = {}
    in_place = output is not Form.JSON and sys.stdout.isatty()
    quiet = dataclasses.replace(fleet, warn=said.setdefault) if in_place else fleet
    with told(every) as end:
        series = (_values(quiet, what, snapshot) for snapshot in looks(quiet, end))
        if in_place:
            _redraw(output, what, series)
        else:
            console.show_all(output, f"{what}_line" if output is Form.JSON else what, series)
    for text in said:
        console.tell(f"warning: {text}")


def _redraw(output: Form, what: str, series: Iterator[Values]) -> None:
    from edgectl.cli.keys import keys
    from edgectl.cli.screen import screen
    from edgectl.views.form import view
    from edgectl.views.text import look_of

    with keys(_quit), screen() as show:
        for values in series:
            show(view(output, what)(*values, look_of(sys.stdout)))


def _quit(key: str) -> None:
    if key in ("q", "Q"):
        os.kill(os.getpid(), signal.SIGINT)


def _interact(loaded: Loaded, every: float, *, readonly: bool, first: str) -> None:
    """The live view of edgectl[tui].

    Raises:
        UsageError: standard output is no terminal, or the extra is not installed.
    """
    from edgectl.cli.extras import extra
    from edgectl.cli.reach import reach

    if not sys.stdout.isatty():
        raise UsageError("standard output is not a terminal", hint="edgectl top hosts -w -o json is for programs")
    with extra("tui"):
        from edgectl.tui import run
    run(reach(loaded, asking=False), every=every, readonly=readonly, first=first)
