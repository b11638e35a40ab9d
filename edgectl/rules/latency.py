# SPDX-License-Identifier: Apache-2.0
"""Latency of a job on a loaded host: service, waiting, transfer and round trip (ADR 119, ADR 125). Pure.

docs/concepts/predicted-latency.md has the formulas, and says when they hold.
"""

from math import exp, hypot, inf, log
from statistics import NormalDist
from typing import NamedTuple

from edgectl.model.predicted_latency import PredictedLatency, ServiceTime
from edgectl.rules.waiting import MAX_LOAD, compute_waiting, compute_waiting_quantile

# Error of the model at the median where it holds (docs/concepts/predicted-latency.md): the interval is wider
# by it.
MODEL_ERROR = 0.10
_MS = 1000.0
_NORMAL = NormalDist()
_Z95 = _NORMAL.inv_cdf(0.95)


class HostLoad(NamedTuple):
    """CPU of a host: ``cores`` in all (> 0), ``used`` of them by others than the task.

    ``others``: the tasks that use them, infinite where that is not known.
    """

    cores: float
    used: float
    others: float = inf


class LinkLoad(NamedTuple):
    """A link: ``capacity`` and the part ``used`` by others in bytes/s, and the round-trip time in s."""

    capacity: float
    used: float
    rtt: float


def estimate_latency(
    service: ServiceTime, host: HostLoad, link: LinkLoad | None, job_bytes: float, *, elsewhere: bool = False
) -> PredictedLatency:
    """Latency of one job on a host; ``link``: to the robot, None where the robot itself is the host.

    Others' jobs are taken to be as long as the task's own. A host of less than one core is one slow core.
    """
    slowness = max(1.0, 1.0 / host.cores)
    median, longer = service.p50 * slowness, service.p95 / service.p50
    load = max(0.0, host.used / host.cores)
    cores = max(1, int(host.cores))
    waiting = compute_waiting(median, median, cores, min(MAX_LOAD, load), host.others)
    longest = median * max(0.0, (host.others + 1) / cores - 1.0)  # all others all the time
    transfer, rtt = (0.0, 0.0) if link is None else (_compute_transfer(link, job_bytes), link.rtt)

    def find_quantile(share: float) -> float:
        """A job that is longer waits longer: the logarithms of both factors add up by their squares."""
        own = longer ** (_NORMAL.inv_cdf(share) / _Z95)
        slower = 1.0 + min(longest, compute_waiting_quantile(waiting, share)) / median
        factor = exp(hypot(log(own), log(slower))) if own > 1.0 else own * slower
        return _MS * (median * factor + transfer + rtt)

    p95 = find_quantile(0.95)
    return PredictedLatency(
        p50_ms=find_quantile(0.50),
        p95_ms=p95,
        p99_ms=find_quantile(0.99),
        low_ms=find_quantile(0.05) * (1.0 - MODEL_ERROR),
        high_ms=p95 * (1.0 + MODEL_ERROR),
        service_ms=_MS * median,
        host_load=load,
        waiting_ms=_MS * waiting.mean,
        transfer_ms=_MS * transfer,
        rtt_ms=_MS * rtt,
        elsewhere=elsewhere,
    )


def _compute_transfer(link: LinkLoad, job_bytes: float) -> float:
    """The bytes of a job at what others leave free of the link, at least 2 % of it."""
    if not job_bytes or link.capacity == inf:
        return 0.0
    return job_bytes / max(link.capacity - link.used, (1.0 - MAX_LOAD) * link.capacity)
