# SPDX-License-Identifier: Apache-2.0
"""export prometheus, csv and jsonl commands."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, exit_codes, options
from edgectl.cli.extras import require_extra
from edgectl.cli.project import choose_files
from edgectl.cli.user_files import PUBLIC_FILE_MODE, load_inputs, save_file
from edgectl.errors import UsageError
from edgectl.export.history_rows import RowKind, format_csv_lines, format_json_lines
from edgectl.model.point import HistoryPoint

_KindArgument = Annotated[
    RowKind,
    Argument(metavar="KIND", help="hosts, links, tasks, metrics, handoffs or events.", show_default=False),
]
_SinceOption = Annotated[
    str | None, Option("--since", metavar="TIME", help="Only rows newer than this; default: all.")
]
_OutOption = Annotated[
    Path | None, Option("--out", metavar="FILE", help="Replace this file (mode 0600); default: stdout.")
]


def export_prometheus_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    textfile: Annotated[
        Path | None,
        Option("--textfile", metavar="FILE", help="Replace this file, for node_exporter: mode 0644."),
    ] = None,
    listen: Annotated[
        str | None, Option("--listen", metavar="[HOST:]PORT", help="Serve /metrics; default HOST: 127.0.0.1.")
    ] = None,
    every: Annotated[
        str, Option("--every", metavar="TIME", help="Minimum pause of probes (--listen).")
    ] = "15s",
    timeout: options.TimeoutOption = "8s",
    allow_unreachable: options.AllowUnreachableOption = False,
) -> None:
    """Probe and print Prometheus metrics: hosts, links, tasks, decisions, handoffs. Nothing is changed.

    Needs the extra metrics.

    Examples:
        edgectl export prometheus
        edgectl export prometheus --textfile edgectl.prom
        edgectl export prometheus --listen 127.0.0.1:9815
    """
    with require_extra("metrics"):
        from edgectl.export import prometheus
    from edgectl.cli.connect import build_fleet, parse_duration_option
    from edgectl.cli.http_server import serve_http
    from edgectl.gateway.host_probe import ProbeOptions
    from edgectl.usecases.scrape import RevisionCache, SharedCache, collect_fleet_metrics, keep_sessions_open

    if textfile is not None and listen is not None:
        raise UsageError("--textfile and --listen exclude each other", hint="run edgectl twice")
    fleet = build_fleet(load_inputs(inventory, tasks))
    how, period = (
        ProbeOptions(timeout=parse_duration_option(timeout, "--timeout")),
        parse_duration_option(every, "--every"),
    )
    if listen is not None:
        with keep_sessions_open(fleet) as near:
            past = RevisionCache(near)
            look = SharedCache(lambda: collect_fleet_metrics(near, how, past), every=period)
            serve_http(
                lambda address: prometheus.bind_metrics_server(address, look, fleet.warn), listen, "/metrics"
            )
        return
    seen = collect_fleet_metrics(fleet, how)
    if textfile is None:
        console.print_text(prometheus.render_metrics_page(seen))
    else:
        save_file(textfile, prometheus.render_metrics_page(seen), mode=PUBLIC_FILE_MODE)
    raise Exit(exit_codes.of_snapshot(seen.snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def export_csv_command(
    *,
    kind: _KindArgument,
    inventory: options.InventoryOption = None,
    since: _SinceOption = None,
    out: _OutOption = None,
) -> None:
    """Export the history as CSV: measurements of hosts, links and tasks, application metrics, handoffs, or
    events.

    No host is contacted.

    Examples:
        edgectl export csv tasks --since 1h
        edgectl export csv hosts --out hosts.csv
    """
    _run_export(format_csv_lines, kind, inventory, since, out)


def export_jsonl_command(
    *,
    kind: _KindArgument,
    inventory: options.InventoryOption = None,
    since: _SinceOption = None,
    out: _OutOption = None,
) -> None:
    """Export the history as JSON Lines: measurements of hosts, links and tasks, application metrics,
    handoffs, or events.

    No host is contacted.

    Examples:
        edgectl export jsonl links --since 1h
        edgectl export jsonl events --out events.jsonl
    """
    _run_export(format_json_lines, kind, inventory, since, out)


def _run_export(
    lines: Callable[[RowKind, Iterable[HistoryPoint]], Iterator[str]],
    kind: RowKind,
    inventory: Sequence[Path] | None,
    since: str | None,
    out: Path | None,
) -> None:
    from edgectl.cli.connect import parse_duration_option, print_warning
    from edgectl.config.load import load_inventory
    from edgectl.state.fleet_dir import ensure_fleet_dir
    from edgectl.usecases.export import export_history

    begin = time.time() - parse_duration_option(since, "--since") if since is not None else None
    paths = choose_files(inventory, None).inventories
    state = ensure_fleet_dir(load_inventory(paths).fleet, paths[0])
    put = console.print_lines if out is None else partial(save_file, out)
    export_history(state, kind, lambda found: put(lines(kind, found)), since=begin, warn=print_warning)
