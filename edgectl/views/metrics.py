# SPDX-License-Identifier: Apache-2.0
"""Metrics that applications report."""

from collections.abc import Iterable, Mapping

from edgectl.model.snapshot import TaskSample
from edgectl.views.glossary import head
from edgectl.views.text import Cell, Row


def format_metric(number: float) -> str:
    """Six digits: ``29.97``, ``1.5e-07``."""
    return f"{number:.6g}"


def format_metrics(metrics: Mapping[str, float]) -> str:
    """All on one line, ``fps 29.97, loss 0.031``; a dash where there are none."""
    return ", ".join(f"{name} {format_metric(number)}" for name, number in metrics.items()) or "-"


def render_metrics_rows(runs: Iterable[tuple[str, str, TaskSample]]) -> list[Row]:
    """A row for each of the runs (task, host) that reports metrics, with headings; empty where none does."""
    rows: list[Row] = [
        (Cell(task, "name"), host, format_metrics(sample.metrics))
        for task, host, sample in runs
        if sample.metrics
    ]
    return [head("task", "host", "metrics"), *rows] if rows else []
