"""export cron and export systemd: run a fleet by itself."""

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from typer import Option

from edgectl.cli import console, options
from edgectl.cli.inputs import inventory_file, load, make, save, task_files
from edgectl.errors import UsageError
from edgectl.export.job import Job

EveryOption = Annotated[str | None, Option("--every", metavar="TIME", help="From one run to the next.", show_default=False)]


def export_cron_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    every: EveryOption = None,
    out: Annotated[Path | None, Option("--out", metavar="FILE", help="Write to a file instead of standard output.")] = None,
) -> None:
    """Print the line of a crontab that applies this fleet's tasks every 5 minutes, or --every.

    Paths are absolute, and EDGECTL_STATE_DIR goes along: cron starts with an almost empty environment.

    Examples:
        edgectl export cron --every 15m
    """
    from edgectl.export.cron import crontab

    job = _job(inventory, tasks, every)
    try:
        text = crontab(job)
    except ValueError as error:
        raise _refusal(error) from None
    _give(text, out)


def export_systemd_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    every: EveryOption = None,
    watch: Annotated[bool, Option("--watch", help="One service that runs edgectl watch --apply.")] = False,
    user: Annotated[bool, Option("--user", help="For your own systemd instead of the system's.")] = False,
    out: Annotated[Path | None, Option("--out", metavar="DIR", help="Write the files there, made where missing.")] = None,
) -> None:
    """Print systemd units: a service and a timer that apply every 5 minutes, or --every; or with --watch one service.

    Comments in the units say how to install them. Unreachable hosts (4) and a busy lock (75) are no failure of the unit.

    Examples:
        edgectl export systemd --user --every 90s --out units
        edgectl export systemd --watch
    """
    from edgectl.export.systemd import timer_units, watch_unit

    job = _job(inventory, tasks, every)
    try:
        units = watch_unit(job, user=user) if watch else timer_units(job, user=user)
    except ValueError as error:
        raise _refusal(error) from None
    if out is None:
        _give("\n".join(units.values()), None)
        return
    make(out)
    for name, text in units.items():
        _give(text, out / name)


def _refusal(error: ValueError) -> UsageError:
    message, _, hint = str(error).partition("; ")
    return UsageError(message, hint=hint)


def _give(text: str, out: Path | None) -> None:
    if out is None:
        console.put(text)
    else:
        save(out, text)
        console.tell(f"wrote {out}")


def _job(inventory: Path | None, tasks: Sequence[Path] | None, every: str | None) -> Job:
    """The fleet as it is called now; files that are wrong are found here and not at night."""
    from edgectl.cli.reach import seconds
    from edgectl.model.inventory import Connection
    from edgectl.state.lock import user

    loaded = load(inventory, tasks)
    return Job(
        name=loaded.path.stem,
        program=_program(),
        inventory=str(inventory_file(inventory).absolute()),
        tasks=tuple(str(path.absolute()) for path in tasks or task_files(None)),
        directory=str(Path.cwd()),
        user=user(),
        environment=_environment(os.environ),
        every_s=None if every is None else seconds(every, "--every"),
        local=any(host.connection is Connection.LOCAL for host in loaded.inventory.hosts.values()),
    )


def _program() -> tuple[str, ...]:
    """The edgectl that runs now."""
    beside = Path(sys.executable).with_name("edgectl")
    return (str(beside),) if os.access(beside, os.X_OK) else (sys.executable, "-m", "edgectl")


def _environment(here: Mapping[str, str]) -> dict[str, str]:
    """Another state directory would be another lock and another memory, so it goes along."""
    from edgectl.state.paths import root

    found = {"EDGECTL_STATE_DIR": str(root().absolute())} if here.get("EDGECTL_STATE_DIR") or here.get("XDG_STATE_HOME") else {}
    return found | ({"EDGECTL_SSH_CONFIG": os.path.abspath(here["EDGECTL_SSH_CONFIG"])} if here.get("EDGECTL_SSH_CONFIG") else {})  # noqa: PTH100
