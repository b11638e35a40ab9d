# SPDX-License-Identifier: Apache-2.0
"""Byte counters of a host for the addresses of the robots, as the host reports them (ADR 104)."""

from collections.abc import Mapping
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.model.snapshot import COUNTERS_INSTALLED


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotCounter:
    """Bytes of the IP packets of one robot since the installation, and bytes/s with the headers of frames.

    ``addresses``: as this host resolves them; ``counted``: whether each has a counter; ``tcp_bytes``: of both
    directions, the part that is TCP.
    """

    addresses: tuple[str, ...] = ()
    counted: bool = False
    rx_bytes: float = 0.0
    tx_bytes: float = 0.0
    tcp_bytes: float = 0.0
    rx_bytes_per_s: float = 0.0
    tx_bytes_per_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ByteCounters:
    """The counters of one host.

    ``state``: empty where none are installed, "installed", or why they cannot be read. ``tasks``: whether
    tasks in systemd scopes are counted too. ``error`` and ``hint``: why the host did not do what was asked.
    """

    host: str
    state: str = ""
    tasks: bool = False
    robots: Mapping[str, RobotCounter] = field(default_factory=dict)
    error: str = ""
    hint: str = ""

    @property
    def installed(self) -> bool:
        """Whether they are there and can be read."""
        return self.state == COUNTERS_INSTALLED
