# SPDX-License-Identifier: Apache-2.0
"""export cron and export systemd commands."""

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from typer import Option

from edgectl.cli import console, options
from edgectl.cli.project import choose_files
from edgectl.cli.user_files import (
    PUBLIC_FILE_MODE,
    list_task_files,
    load_inputs,
    make_directory,
    refuse_exposed_files,
    save_file,
)
from edgectl.export.job import ScheduledJob

JobPeriodOption = Annotated[
    str | None, Option("--every", metavar="TIME", help="Time between runs.", show_default=False)
]


def export_cron_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    every: JobPeriodOption = None,
    out: Annotated[
        Path | None, Option("--out", metavar="FILE", help="Write to a file; default: stdout.")
    ] = None,
) -> None:
    """Print a crontab line that applies this fleet's tasks every 5 minutes, or --every.

    Paths are absolute, and EDGECTL_STATE_DIR is included: cron starts with an almost empty environment.

    Examples:
        edgectl export cron --every 15m
    """
    from edgectl.export.cron import format_crontab

    job = _build_job(inventory, tasks, every)
    _write_output(format_crontab(job), out)


def export_systemd_command(
    *,
    inventory: options.InventoryOption = None,
    tasks: options.TasksOption = None,
    every: JobPeriodOption = None,
    watch: Annotated[bool, Option("--watch", help="One service that runs edgectl watch --apply.")] = False,
    user: Annotated[bool, Option("--user", help="For your user's systemd instance.")] = False,
    out: Annotated[
        Path | None, Option("--out", metavar="DIR", help="Write the files to this directory.")
    ] = None,
) -> None:
    """Print systemd units: a service and a timer that apply every 5 minutes, or --every; or with --watch one
    service.

    Comments in the units explain how to install them. Unreachable hosts (4) and a busy lock (75) do not
    fail the unit.

    Examples:
        edgectl export systemd --user --every 90s --out units
        edgectl export systemd --watch
    """
    from edgectl.export.systemd import build_timer_units, build_watch_unit

    job = _build_job(inventory, tasks, every)
    units = build_watch_unit(job, user=user) if watch else build_timer_units(job, user=user)
    if out is None:
        _write_output("\n".join(units.values()), None)
        return
    make_directory(out)
    for name, text in units.items():
        _write_output(text, out / name)


def _write_output(text: str, out: Path | None) -> None:
    if out is None:
        console.print_text(text)
    else:
        save_file(out, text, mode=PUBLIC_FILE_MODE)
        console.print_message(f"wrote {out}")


def _build_job(
    inventory: Sequence[Path] | None, tasks: Sequence[Path] | None, every: str | None
) -> ScheduledJob:
    """The job for the fleet as called now; invalid files are found here, not at night."""
    from edgectl.cli.connect import parse_duration_option
    from edgectl.model.inventory import Connection
    from edgectl.state.lock import get_user_name
    from edgectl.usecases.heartbeat import list_self_fences

    loaded, chosen = load_inputs(inventory, tasks), choose_files(inventory, tasks)
    refuse_exposed_files(loaded.exposed)
    return ScheduledJob(
        name=loaded.path.stem,
        program=_find_own_command(),
        inventories=tuple(os.path.abspath(path) for path in chosen.inventories),  # noqa: PTH100
        tasks=tuple(os.path.abspath(path) for path in chosen.tasks or list_task_files(chosen)),  # noqa: PTH100
        directory=str(Path.cwd()),
        user=get_user_name(),
        environment=_collect_job_environment(os.environ),
        every_s=None if every is None else parse_duration_option(every, "--every"),
        self_fence_s=min(list_self_fences(loaded.tasks), default=None),
        local=any(host.connection is Connection.LOCAL for host in loaded.inventory.hosts.values()),
    )


def _find_own_command() -> tuple[str, ...]:
    """Path of the edgectl that runs now."""
    beside = Path(sys.executable).with_name("edgectl")
    return (str(beside),) if os.access(beside, os.X_OK) else (sys.executable, "-m", "edgectl")


def _collect_job_environment(here: Mapping[str, str]) -> dict[str, str]:
    """Environment of the job; another state directory would mean another lock and another history."""
    from edgectl.state.paths import get_state_root

    found = (
        {"EDGECTL_STATE_DIR": str(get_state_root().absolute())}
        if here.get("EDGECTL_STATE_DIR") or here.get("XDG_STATE_HOME")
        else {}
    )
    return found | (
        {"EDGECTL_SSH_CONFIG": os.path.abspath(here["EDGECTL_SSH_CONFIG"])}  # noqa: PTH100
        if here.get("EDGECTL_SSH_CONFIG")
        else {}
    )
