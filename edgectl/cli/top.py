# SPDX-License-Identifier: Apache-2.0
"""top hosts and top tasks commands."""

import dataclasses
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING

from typer import Exit

from edgectl.cli import console, exit_codes, options
from edgectl.cli.listing_fields import list_field, rank_documents
from edgectl.cli.signals import catch_stop_signals, parse_every_option
from edgectl.cli.user_files import LoadedInputs, load_inputs
from edgectl.dataclass import dataclass
from edgectl.errors import UsageError
from edgectl.views.output_format import OutputFormat

if TYPE_CHECKING:
    from edgectl.model.snapshot import Snapshot
    from edgectl.usecases.fleet import Fleet
    from edgectl.views.output import ListView, View


def top_hosts_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.WideOutput = OutputFormat.TABLE,
    watch: options.WatchOption = False,
    every: options.EveryOption = "2s",
    sort_by: options.SortByOption = None,
    field: options.FieldOption = None,
    no_headers: options.NoHeadersOption = False,
    interactive: options.InteractiveOption = False,
    readonly: options.ReadonlyOption = False,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show CPU, memory and busiest link of each host, now and over its last 60 recorded samples.

    A share above the limit of the inventory ends in "!". Without a terminal the output is numbers only; -w -o
    json is one object per line.

    Examples:
        edgectl top hosts
        edgectl top hosts -o wide
        edgectl top hosts -w --every 5s
        edgectl top hosts -w -o json
    """
    loaded, period = load_inputs(inventory, tasks, needs_tasks=False), parse_every_option(every)
    if interactive:
        return _run_live_view(loaded, period, readonly=readonly, first="hosts")
    look = _TopLook(sort_by=sort_by, field=field, headers=not no_headers)
    every_s = period if watch else None
    raise Exit(_print_top(loaded, "hosts", output, every_s, look, allow_unreachable=allow_unreachable))


def top_tasks_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    output: options.WideOutput = OutputFormat.TABLE,
    watch: options.WatchOption = False,
    every: options.EveryOption = "2s",
    sort_by: options.SortByOption = None,
    field: options.FieldOption = None,
    no_headers: options.NoHeadersOption = False,
    interactive: options.InteractiveOption = False,
    readonly: options.ReadonlyOption = False,
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Show usage of each task against its demand (CPU EXCESS: usage minus demand), now and over its last 60
    recorded samples.

    Without a terminal the output is numbers only; -w -o json is one object per line.

    Examples:
        edgectl top tasks -o wide
        edgectl top tasks -w
    """
    loaded, period = load_inputs(inventory, tasks), parse_every_option(every)
    if interactive:
        return _run_live_view(loaded, period, readonly=readonly, first="tasks")
    look = _TopLook(sort_by=sort_by, field=field, headers=not no_headers)
    every_s = period if watch else None
    raise Exit(_print_top(loaded, "tasks", output, every_s, look, allow_unreachable=allow_unreachable))


@dataclass(frozen=True, slots=True, kw_only=True)
class _TopLook:
    """Which rows come first, which key alone is printed, and whether there are headings."""

    sort_by: str | None
    field: str | None
    headers: bool


def _print_top(
    loaded: LoadedInputs,
    what: str,
    output: OutputFormat,
    every: float | None,
    look: _TopLook,
    *,
    allow_unreachable: bool,
) -> int:
    """Print once, or with ``every`` repeatedly."""
    from edgectl.cli.connect import build_fleet
    from edgectl.usecases.probe import probe_fleet
    from edgectl.views.output_format import STREAM_FORMATS, check_output_format

    if every is not None:
        check_output_format(output, STREAM_FORMATS)
        if look.field is not None:
            raise UsageError("-w shows whole rows", hint="omit --field")
    fleet = build_fleet(loaded)
    if every is None:
        snapshot = probe_fleet(fleet)
        view = _build_view(fleet, what, snapshot, look)
        if look.field is not None:
            console.print_lines(line + "\n" for line in list_field(view.items(), look.field, view.kind))
        else:
            console.print_view(view, output, fleet=fleet.inventory.fleet if look.headers else "")
        return exit_codes.of_snapshot(snapshot, fleet.inventory, allow_unreachable=allow_unreachable)
    _watch_top(fleet, what, output, every, look)
    return 0


def _build_view(fleet: "Fleet", what: str, snapshot: "Snapshot", look: _TopLook) -> "ListView":
    from edgectl.usecases.status import load_host_points, load_task_points
    from edgectl.views.sparkline import SPARKLINE_SAMPLES
    from edgectl.views.top_hosts import TopHostsView
    from edgectl.views.top_tasks import TopTasksView

    make: Callable[..., ListView]
    if what == "hosts":
        make = partial(
            TopHostsView,
            snapshot,
            fleet.inventory,
            load_host_points(fleet, SPARKLINE_SAMPLES),
            headers=look.headers,
        )
    else:
        points = load_task_points(fleet, SPARKLINE_SAMPLES)
        make = partial(TopTasksView, snapshot, fleet.inventory, fleet.tasks, points, headers=look.headers)
    view = make()
    if look.sort_by is None:
        return view
    items = view.items()
    return make(order=rank_documents(items, look.sort_by, view.kind))


def _watch_top(fleet: "Fleet", what: str, output: OutputFormat, every: float, look: _TopLook) -> None:
    """Refresh in place on a terminal, else print one after the other, until Ctrl-C (or q)."""
    from edgectl.usecases.status import probe_repeatedly

    warnings: dict[str, None] = {}
    in_place = output in (OutputFormat.TABLE, OutputFormat.WIDE) and sys.stdout.isatty()
    quiet = dataclasses.replace(fleet, warn=warnings.setdefault) if in_place else fleet
    with catch_stop_signals(every) as end:
        views = (_build_view(quiet, what, snapshot, look) for snapshot in probe_repeatedly(quiet, end))
        if in_place:
            _redraw_screen(views, output, fleet.inventory.fleet if look.headers else "")
        else:
            console.print_view_series(views, output)
    for text in warnings:
        console.print_message(f"warning: {text}")


def _redraw_screen(views: "Iterator[View]", output: OutputFormat, name: str) -> None:
    """``name``: of the fleet, above each table; "" for none."""
    from edgectl.cli.terminal import listen_for_keys, open_screen
    from edgectl.views.notes import render_notes
    from edgectl.views.output import render_view
    from edgectl.views.text import detect_render_options, render_fleet_line

    with listen_for_keys(_quit_on_q), open_screen() as show:
        for view in views:
            look = detect_render_options(sys.stdout)
            head = render_fleet_line(name, look) if name else ""
            show(head + render_view(view, output, look) + render_notes(view.notes(), look))


def _quit_on_q(key: str) -> None:
    if key in ("q", "Q"):
        os.kill(os.getpid(), signal.SIGINT)


def _run_live_view(loaded: LoadedInputs, every: float, *, readonly: bool, first: str) -> None:
    """The full-screen view of the extra tui.

    Raises:
        UsageError: stdout is not a terminal, or the extra is not installed.
    """
    from edgectl.cli.connect import build_fleet
    from edgectl.cli.extras import require_extra

    if not sys.stdout.isatty():
        raise UsageError("stdout is not a terminal", hint="for programs: edgectl top hosts -w -o json")
    with require_extra("tui"):
        from edgectl.tui import run_top_view
    run_top_view(
        build_fleet(loaded, asking=False),
        every=every,
        readonly=readonly,
        first=first,
        open_shell=lambda host: _open_shell(loaded, host),
    )


def _open_shell(loaded: LoadedInputs, host: str) -> int:
    """Run ``edgectl ssh HOST`` on the same inventories, with the terminal; its exit code."""
    files = [word for path in loaded.inventories for word in ("-i", str(path))]
    return subprocess.run([sys.executable, "-m", "edgectl", "ssh", host, *files], check=False).returncode
