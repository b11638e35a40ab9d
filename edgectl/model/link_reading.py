# SPDX-License-Identifier: Apache-2.0
"""Observations of a link, and the readings of its live capacity (ADR 0077)."""

from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.model.encoding import Instant, in_document
from edgectl.model.snapshot import CapacitySource


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkObservation:
    """One link as a probe saw it.

    ``used_bytes_per_s``: in plus out. ``carries_bytes_per_s``: what it carries now, where a connection is
    limited by it. ``radio_bytes_per_s``: bit rate of the slower radio at its ends. ``interface``: that of the
    edge, "" where unknown. ``rtt_ms``: round-trip time where known. ``answered``: whether the robot answered
    the edge; None: nothing came back.
    """

    used_bytes_per_s: float = 0.0
    carries_bytes_per_s: float | None = None
    radio_bytes_per_s: float | None = None
    interface: str = ""
    rtt_ms: float | None = None
    answered: bool | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkReading:
    """Bytes/s (> 0) at which a link was the limit, on the manager's clock."""

    bytes_per_s: float = field(metadata=in_document(required=True))
    at: Instant = field(metadata=in_document(required=True))
    source: CapacitySource = field(metadata=in_document(required=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkHistory:
    """The last readings of a link, oldest first.

    ``sampled_at``: when it was last probed, 0 for never. ``refused``: that probe found no way. ``rtt_ms``:
    the round-trip time at that probe. ``answered``: the robot has ever answered the edge. ``silent``: probes
    in a row without an answer since then, the first at ``silent_since``; ``cut_off``: so many that it counts.
    ``sampled_before``: the probes before the last that still count against the budget of its hosts.
    ``fell_at``: when it was last seen to carry much less than before, 0 for never.
    """

    readings: tuple[LinkReading, ...] = ()
    sampled_at: Instant = 0.0
    refused: bool = False
    rtt_ms: float | None = None
    answered: bool = False
    silent: int = 0
    silent_since: Instant = 0.0
    cut_off: bool = False
    sampled_before: tuple[Instant, ...] = ()
    fell_at: Instant = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSampleResult:
    """Result of the probe of an idle link.

    ``bytes_per_s``: what arrived, None where too little did. ``full``: the link was the limit, else it
    carries at least that. ``refused``: there was no way from the edge to the robot.
    """

    bytes_per_s: float | None = None
    full: bool = False
    refused: bool = False
