# SPDX-License-Identifier: Apache-2.0
"""Latency of tasks: percentiles and misses."""

from collections.abc import Iterable

from edgectl.formats.document import Document, without_none
from edgectl.model.latency import LatencySample
from edgectl.model.snapshot import TaskSample
from edgectl.views.glossary import head
from edgectl.views.text import Cell, Row
from edgectl.views.usage import format_or_dash

_HEAD = head(
    "task", "host", "p50_ms", "p95_ms", "p99_ms", "max_ms", "bound_ms", "recent_misses", "misses", "count"
)
# Columns of numbers.
RIGHT_COLUMNS = frozenset(range(2, len(_HEAD)))


def format_ms(value: float) -> str:
    """Three digits: ``0.25 ms``, ``12.3 ms``, ``1250 ms``."""
    return f"{value:.0f} ms" if value >= 100 else f"{value:.3g} ms"


def render_latency_rows(runs: Iterable[tuple[str, str, TaskSample]]) -> list[Row]:
    """A row for each of the runs (task, host) whose latency is read, with headings; empty where none is."""
    rows = [
        (Cell(task, "name"), host, *_render_cells(sample.latency))
        for task, host, sample in runs
        if sample.latency is not None
    ]
    return [_HEAD, *rows] if rows else []


def _render_cells(latency: LatencySample) -> Row:
    percentiles = (latency.p50_ms, latency.p95_ms, latency.p99_ms, latency.max_ms, latency.bound_ms)
    bounded = latency.bound_ms is not None
    return (
        *(format_or_dash(value, format_ms) for value in percentiles),
        Cell(str(latency.recent_misses), "bad" if latency.recent_misses else "") if bounded else "-",
        str(latency.misses) if bounded else "-",
        str(latency.count),
    )


def list_latency_notes(runs: Iterable[tuple[str, str, TaskSample]]) -> list[str]:
    """Why the latency of a task is not read."""
    return [
        f"latency of {task} is not known: {sample.latency.error}"
        for task, _, sample in runs
        if sample.latency is not None and sample.latency.error
    ]


def encode_latency(latency: LatencySample | None) -> Document | None:
    """The latency as JSON types, without its buckets; those are in the snapshot."""
    if latency is None:
        return None
    return without_none(
        count=latency.count,
        misses=latency.misses,
        bound_ms=latency.bound_ms,
        p50_ms=latency.p50_ms,
        p95_ms=latency.p95_ms,
        p99_ms=latency.p99_ms,
        max_ms=latency.max_ms,
        recent_s=latency.recent_s,
        recent_count=latency.recent_count,
        recent_misses=latency.recent_misses,
        age_s=latency.age_s,
        error=latency.error or None,
    )
