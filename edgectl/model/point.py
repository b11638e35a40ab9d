# SPDX-License-Identifier: Apache-2.0
"""Rows of the history: measurements of a host, a link or a task, and completed handoffs.

Amounts are in the units of their resources; ``at`` is the instant of the snapshot in s since 1970 on the
manager's clock.
"""

from collections.abc import Iterable, Mapping
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.model.event import Event
from edgectl.model.resource import HOST_RESOURCES, TASK_RESOURCES, Usage
from edgectl.model.result import Outcome
from edgectl.model.snapshot import HostStatus, ResourceUsage, TaskState

# Columns of the amounts of a host and of a task, in the database and in exports.
HOST_AMOUNT_COLUMNS = tuple(
    key for resource in HOST_RESOURCES for key in (resource.capacity_key, resource.used_key)
)
TASK_AMOUNT_COLUMNS = tuple(resource.used_key for resource in TASK_RESOURCES)


@dataclass(frozen=True, slots=True, kw_only=True)
class HostPoint:
    """One host at one instant; no numbers where it did not answer.

    ``usage``: by resource. Rates are summed over its interfaces.
    """

    at: float
    host: str
    status: HostStatus
    usage: Mapping[str, ResourceUsage] = field(default_factory=dict)
    rx_bytes_per_s: float | None = None
    tx_bytes_per_s: float | None = None

    @property
    def amounts(self) -> dict[str, float | None]:
        """Capacity and usage by column."""
        found: dict[str, float | None] = dict.fromkeys(HOST_AMOUNT_COLUMNS)
        for resource in HOST_RESOURCES:
            if (usage := self.usage.get(resource.name)) is not None:
                found |= {resource.capacity_key: usage.capacity, resource.used_key: usage.used}
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkPoint:
    """One edge-robot link at one instant."""

    at: float
    edge: str
    robot: str
    capacity_bytes_per_s: float
    used_bytes_per_s: float
    rtt_ms: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskPoint:
    """One task on one host at one instant, with the use of its whole process tree.

    ``age_s``: seconds since this start. ``links``: number of links that it used, 0 if unknown;
    its use of one link is that of the network divided by ``max(1, links)``.
    """

    at: float
    task: str
    host: str
    state: TaskState
    used: Usage
    instance: str = ""
    spec_hash: str = ""
    age_s: float = 0.0
    links: int = 0

    @property
    def amounts(self) -> dict[str, float]:
        """Usage by column."""
        return {resource.used_key: self.used[resource.name] for resource in TASK_RESOURCES}


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricPoint:
    """Metric published by an application: the ``value`` of its metric ``name``, valid until the next one of
    the same start.
    """

    at: float
    task: str
    host: str
    name: str
    value: float
    instance: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class HandoffPoint:
    """One move or restart that an apply carried out or attempted.

    ``downtime_s``: stop to ready; ``seconds``: all of its phases. ``gap_s``: as the robot heard it.
    """

    at: float
    task: str
    host: str
    previous_host: str | None
    outcome: Outcome
    downtime_s: float | None
    seconds: float
    gap_s: float | None = None


HistoryPoint = HostPoint | LinkPoint | TaskPoint | MetricPoint | HandoffPoint | Event


def get_columns(point: HistoryPoint, columns: Iterable[str]) -> list[object]:
    """The values of ``columns`` of a row: its fields, and its amounts by their own columns."""
    amounts: Mapping[str, object] = point.amounts if isinstance(point, HostPoint | TaskPoint) else {}
    return [amounts[name] if name in amounts else getattr(point, name) for name in columns]
