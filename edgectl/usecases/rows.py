"""export csv and jsonl: the history, row by row. No host is asked."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from edgectl.export.rows import Kind, Point
from edgectl.state import store_rows as rows
from edgectl.state.files import Warn, silent
from edgectl.state.keeper import Keeper
from edgectl.state.store_rows import Form

# Where the rows of each kind lie, and their order: by time, then by name.
_PLACES: dict[Kind, tuple[Form[Any], str, str]] = {
    Kind.HOSTS: (rows.HOSTS, "host_samples", "at, host"),
    Kind.LINKS: (rows.LINKS, "link_samples", "at, edge, robot"),
    Kind.TASKS: (rows.TASKS, "task_samples", "at, task, host"),
    Kind.METRICS: (rows.METRICS, "metric_samples", "at, task, host, name"),
    Kind.HANDOFFS: (rows.HANDOFFS, "handoffs", "id"),
    Kind.EVENTS: (rows.EVENTS, "events", "id"),
}


def export(
    fleet_dir: Path, kind: Kind, take: Callable[[Iterator[Point]], None], *, since: float | None = None, warn: Warn = silent
) -> None:
    """Give ``take`` everything of one kind that is not older than ``since`` (s since 1970), oldest first, however much it is.

    Raises:
        StateError: the history cannot be read to its end.
    """
    Keeper().use(fleet_dir, warn, lambda store: take(store.stream(*_PLACES[kind], since=since)))
