"""A job that cron or systemd runs periodically."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from edgectl.errors import UsageError
from edgectl.units import format_duration


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduledJob:
    """The job of one fleet. All paths are absolute.

    ``name`` names the units. ``program``: the words that start edgectl; ``directory``: where it starts.
    ``environment``: variables besides HOME. ``every_s``: seconds between starts; None: the default of the
    format. ``self_fence_s``: the shortest ``self_fence`` of its tasks.
    ``user`` runs it. ``local``: a host of the fleet is this machine, so tasks run below edgectl itself.
    """

    name: str
    program: tuple[str, ...]
    inventories: tuple[str, ...]
    tasks: tuple[str, ...]
    directory: str
    user: str
    environment: Mapping[str, str] = field(default_factory=dict)
    every_s: float | None = None
    self_fence_s: float | None = None
    local: bool = False


def build_arguments(job: ScheduledJob, *command: str) -> tuple[str, ...]:
    """The arguments of ``command``, without the program.

    Raises:
        UsageError: a path or a variable has characters that crontabs and units do not quote alike.
    """
    files = (
        *(word for path in job.inventories for word in ("-i", path)),
        *(word for path in job.tasks for word in ("-t", path)),
    )
    for text in (*job.program, *files, job.directory, *job.environment.values()):
        if not text.isprintable() or "\\" in text or text != text.strip():
            raise UsageError(
                f"cannot be quoted for cron or systemd: {text!r}",
                hint="rename it without control characters, backslashes and outer blanks",
            )
    return (*command, *files)


def check_self_fence(job: ScheduledJob, every_s: float) -> None:
    """Refuse an interval in which tasks that fence themselves would be without a heartbeat for too long.

    Raises:
        UsageError: ``self_fence`` is shorter than two intervals.
    """
    if job.self_fence_s is not None and job.self_fence_s < 2 * every_s:
        raise UsageError(
            f"every {format_interval(every_s)} is too seldom: no heartbeat is sent between two runs, so "
            f"tasks with self_fence {format_interval(job.self_fence_s)} would stop themselves (needed: 2 x "
            f"{format_interval(every_s)})",
            hint="edgectl export systemd --watch, a shorter --every, or a longer self_fence",
        )


def format_interval(every_s: float) -> str:
    """Format an interval for people: ``5m``, ``1h30m``, ``10s``."""
    return re.sub(r"(?<=[dhm])00[hms]$", "", format_duration(every_s).replace(".0s", "s"))
