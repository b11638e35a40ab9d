# SPDX-License-Identifier: Apache-2.0
"""Export of the history as rows; no host is asked."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from edgectl.export.history_rows import RowKind
from edgectl.model.point import HistoryPoint
from edgectl.state import store_rows as rows
from edgectl.state.json_files import Warn, ignore_warning
from edgectl.state.store_handle import StoreHandle
from edgectl.state.store_rows import RowMapper

# Table and order of the rows of each kind: by time, then by name.
_TABLES: dict[RowKind, tuple[RowMapper[Any], str, str]] = {
    RowKind.HOSTS: (rows.HOSTS, "host_samples", "at, host"),
    RowKind.LINKS: (rows.LINKS, "link_samples", "at, edge, robot"),
    RowKind.TASKS: (rows.TASKS, "task_samples", "at, task, host"),
    RowKind.METRICS: (rows.METRICS, "metric_samples", "at, task, host, name"),
    RowKind.HANDOFFS: (rows.HANDOFFS, "handoffs", "id"),
    RowKind.EVENTS: (rows.EVENTS, "events", "id"),
}


def export_history(
    fleet_dir: Path,
    kind: RowKind,
    take: Callable[[Iterator[HistoryPoint]], None],
    *,
    since: float | None = None,
    warn: Warn = ignore_warning,
) -> None:
    """Pass all rows of one kind that are not older than ``since`` (s since 1970) to ``take``, oldest first,
    in bounded memory.

    Raises:
        StateError: the history cannot be read to its end.
    """
    StoreHandle().use(fleet_dir, warn, lambda store: take(store.stream(*_TABLES[kind], since=since)))
