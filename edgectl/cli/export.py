"""export prometheus, csv and jsonl."""

from pathlib import Path
from typing import Annotated

from typer import Exit, Option

from edgectl.cli import console, exits, options
from edgectl.cli.extras import extra
from edgectl.cli.inputs import load, save
from edgectl.errors import UsageError

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
    from edgectl.usecases.scrape import Shared, picture

    if textfile is not None and listen is not None:
        raise UsageError("--textfile and --listen exclude each other", hint="run edgectl twice")
    fleet = reach(load(inventory, tasks))
    how, period = ProbeOptions(timeout=seconds(timeout, "--timeout")), seconds(every, "--every")
    if listen is not None:
        look = Shared(lambda: picture(fleet, how), every=period)
        serve(lambda address: prometheus.server(address, look, fleet.warn), listen)
        return
    seen = picture(fleet, how)
    if textfile is None:
        console.put(prometheus.text(seen))
    else:
        save(textfile, prometheus.text(seen), mode=_READABLE)
    raise Exit(exits.of_snapshot(seen.snapshot, fleet.inventory, allow_unreachable=allow_unreachable))
