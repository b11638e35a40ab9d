"""History: one row each of what was measured of a host, a link or a task, or of a handoff that was made.

Quantities are cores, bytes and bytes per second; ``at`` is the instant of the snapshot in s since 1970 on the
manager's clock.
"""

from dataclasses import dataclass

from edgectl.model.result import Outcome
from edgectl.model.snapshot import HostStatus, TaskState


@dataclass(frozen=True, slots=True, kw_only=True)
class HostPoint:
    """One host at one instant; no numbers where it did not answer. Rates are summed over its interfaces."""

    at: float
    host: str
    status: HostStatus
    cores: float | None = None
    used_cores: float | None = None
    total_bytes: float | None = None
    used_bytes: float | None = None
    rx_bytes_per_s: float | None = None
    tx_bytes_per_s: float | None = None


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

    ``age_s``: seconds since this very start. ``links``: how many links it used, 0 where that is not known;
    its use of one link is ``used_bytes_per_s / max(1, links)``.
    """

    at: float
    task: str
    host: str
    state: TaskState
    used_cores: float
    used_bytes: float
    used_bytes_per_s: float
    instance: str = ""
    spec_hash: str = ""
    age_s: float = 0.0
    links: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricPoint:
    """Metric published by an application: the ``value`` of its metric ``name``, which stood until the next
    one of this very start.
    """

    at: float
    task: str
    host: str
    name: str
    value: float
    instance: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class HandoffPoint:
    """One move or restart that an apply carried out, or tried.

    ``downtime_s``: stop to ready; ``seconds``: all of its phases.
    """

    at: float
    task: str
    host: str
    previous_host: str | None
    outcome: Outcome
    downtime_s: float | None
    seconds: float
