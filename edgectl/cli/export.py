"""export prometheus, csv and jsonl."""

import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from edgectl.cli import console, exits, options
from edgectl.cli.extras import extra
from edgectl.cli.inputs import inventory_file, load, save
from edgectl.errors import UsageError
from edgectl.export.rows import Kind, Point, csv_lines, json_lines

_KindArgument = Annotated[Kind, Argument(metavar="KIND", help="hosts, links, tasks, metrics, handoffs or events.", show_default=False)]
_SinceOption = Annotated[str | None, Option("--since", metavar="TIME", help="Not older than this; else everything.")]
_OutOption = Annotated[Path | None, Option("--out", metavar="FILE", help="Replace this file; else to standard output.")]
# node_exporter runs as somebody else.
_READABLE = 0o644


def export_prometheus_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    textfile: Annotated[Path | None, Option("--textfile", metavar="FILE", help="Replace this file, for node_exporter.")] = None,
    listen: Annotated[str | None, Option("--listen", metavar="[HOST:]PORT", help="Serve /metrics; HOST is 127.0.0.1.")] = None,
    every: Annotated[str, Option("--every", metavar="TIME", help="Probe at most this often (--listen).")] = "15s",
    timeout: options.TimeoutOption = "8s",
    allow_unreachable: options.AllowOption = False,
) -> None:
    """Probe, and say what was found as Prometheus metrics: hosts, links, tasks, decisions, handoffs. Nothing is changed.

    Needs the extra edgectl[metrics].

    Examples:
        edgectl export prometheus
        edgectl export prometheus --textfile edgectl.prom
        edgectl export prometheus --listen 127.0.0.1:9815
    """
    with extra("metrics"):
        from edgectl.export import prometheus
    from edgectl.cli.reach import reach, seconds
    from edgectl.cli.serve import serve
    from edgectl.gateway.collect import ProbeOptions
    from edgectl.usecases.scrape import Past, Shared, held, picture

    if textfile is not None and listen is not None:
        raise UsageError("--textfile and --listen exclude each other", hint="run edgectl twice")
    fleet = reach(load(inventory, tasks))
    how, period = ProbeOptions(timeout=seconds(timeout, "--timeout")), seconds(every, "--every")
    if listen is not None:
        with held(fleet) as near:
            past = Past(near)
            look = Shared(lambda: picture(near, how, past), every=period)
            serve(lambda address: prometheus.server(address, look, fleet.warn), listen)
        return
    seen = picture(fleet, how)
    if textfile is None:
        console.put(prometheus.text(seen))
    else:
        save(textfile, prometheus.text(seen), mode=_READABLE)
    raise Exit(exits.of_snapshot(seen.snapshot, fleet.inventory, allow_unreachable=allow_unreachable))


def export_csv_command(
    *, kind: _KindArgument, inventory: options.InventoryOption = None, since: _SinceOption = None, out: _OutOption = None
) -> None:
    """Write the history as CSV: what was measured of hosts, links and tasks, what applications said, handoffs, or events.

    No host is asked.

    Examples:
        edgectl export csv tasks --since 1h
        edgectl export csv hosts --out hosts.csv
    """
    _export(csv_lines, kind, inventory, since, out)


def export_jsonl_command(
    *, kind: _KindArgument, inventory: options.InventoryOption = None, since: _SinceOption = None, out: _OutOption = None
) -> None:
    """Write the history as JSON Lines: what was measured of hosts, links and tasks, what applications said, handoffs, or events.

    No host is asked.

    Examples:
        edgectl export jsonl links --since 1h
        edgectl export jsonl events --out events.jsonl
    """
    _export(json_lines, kind, inventory, since, out)


def _export(
    lines: Callable[[Kind, Iterable[Point]], Iterator[str]], kind: Kind, inventory: Path | None, since: str | None, out: Path | None
) -> None:
    from edgectl.cli.reach import seconds, warn
    from edgectl.config.load import load_inventory
    from edgectl.state.paths import fleet_dir
    from edgectl.usecases.rows import export

    begin = time.time() - seconds(since, "--since") if since is not None else None
    path = inventory_file(inventory)
    load_inventory(path)
    put = console.put_lines if out is None else partial(save, out)
    export(fleet_dir(path), kind, lambda found: put(lines(kind, found)), since=begin, warn=warn)
