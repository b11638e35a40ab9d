# SPDX-License-Identifier: Apache-2.0
"""Latency of a task's jobs: what its file states of them, and what is predicted on a host."""

from edgectl.dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceTime:
    """Time in s (> 0) that one job takes on an idle host: median, and 95th percentile (not less)."""

    p50: float
    p95: float


@dataclass(frozen=True, slots=True, kw_only=True)
class JobSize:
    """Bytes of one job: ``received`` from the robot, and ``sent`` back to it."""

    received: float = 0.0
    sent: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedLatency:
    """Latency of one job of a task on a host, from the robot and back: percentiles and parts in ms.

    ``low_ms`` to ``high_ms``: where nine jobs of ten are expected, widened by the error of the model.
    ``service_ms``: median on an idle host; ``host_load``: the share of the CPU that others use there;
    ``waiting_ms``: what that adds on average; ``transfer_ms``: its bytes at what is free of the link.
    ``elsewhere``: no service time is stated for this class of hosts, so the longest of the others counts.
    """

    p50_ms: float
    p95_ms: float
    p99_ms: float
    low_ms: float
    high_ms: float
    service_ms: float
    host_load: float
    waiting_ms: float
    transfer_ms: float
    rtt_ms: float
    elsewhere: bool = False
