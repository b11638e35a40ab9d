# SPDX-License-Identifier: Apache-2.0
"""Model of the latency of a job on a loaded host, in closed forms (ADR 119). Pure.

A job of S seconds shares the cores with the work of others, which arrives at random: the queue M/G/c with
processor sharing. docs/concepts/latency.md derives each formula, and says when it holds.
"""

from functools import lru_cache
from math import exp, expm1, hypot, inf, sqrt
from statistics import NormalDist
from typing import NamedTuple

from edgectl.model.predicted_latency import PredictedLatency, ServiceTime

# Above this share of the capacity no queue is steady: a higher load counts as this one.
MAX_LOAD = 0.98
# Error of the model at the median where it holds (docs/concepts/latency.md): the interval is so much wider.
MODEL_ERROR = 0.10
_MS = 1000.0
_NORMAL = NormalDist()
_Z95 = _NORMAL.inv_cdf(0.95)


class Waiting(NamedTuple):
    """What waiting adds to a job: mean (s), variance (s^2); ``none``: the share of jobs that do not wait."""

    mean: float
    variance: float
    none: float


NO_WAITING = Waiting(0.0, 0.0, 1.0)


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


def compute_busy_probability(cores: int, load: float) -> float:
    """Erlang's C: the probability that all ``cores`` are busy at ``load`` (0..1) of each.

    For one core it is the load.
    """
    blocked, offered = 1.0, cores * load
    for count in range(1, cores + 1):
        blocked = offered * blocked / (count + offered * blocked)
    return blocked / (1.0 - load * (1.0 - blocked))


@lru_cache(maxsize=65_536)
def compute_waiting(work: float, burst: float, cores: int, load: float, others: float = inf) -> Waiting:
    """What sharing ``cores`` adds to a job of ``work`` s, if others' jobs take ``burst`` s on average.

    The mean of M/G/c with processor sharing: work x C / (c (1 - load)), whatever the distribution of others'
    jobs. The variance of M/M/1 with processor sharing (exact for one core); for more cores that of one core,
    c times as fast, among the jobs that find all busy. A job does not wait if it finds a free core and no
    more jobs than there are free cores come while it runs: exact for one core.

    ``others``: so many tasks make the load, each one job after the other; fewer of them meet at a time.
    """
    if load <= 0.0 or work <= 0.0 or others < cores:
        return NO_WAITING
    busy, idle = compute_busy_probability(cores, load), 1.0 - load
    mean = work * busy / (cores * idle)
    alone = _compute_variance_of_one_core(work / cores, burst / cores, load)
    mean_alone = work / cores * load / idle
    last_core = busy * idle / load / (1.0 - busy)
    waiting = Waiting(
        mean=mean,
        variance=busy / load * (alone + mean_alone**2) - mean**2,
        none=(1.0 - busy) * exp(-load * cores / burst * last_core * work),
    )
    return waiting if others == inf else _limit_others(waiting, cores, load, others)


def _limit_others(waiting: Waiting, cores: int, load: float, others: float) -> Waiting:
    """``waiting`` if ``others`` tasks make the load, n of them beyond the free cores.

    Each is busy a share p = (load / n) / (1 - load (n - 1) / n) of the time, n p of them at once on average,
    with a variance between that of independent tasks (n = 1) and that of very many.
    """
    count = others - cores + 1
    free = 1.0 - load * (count - 1) / count
    share, idle = load / count / free, 1.0 - load
    return Waiting(
        mean=waiting.mean * count * share / (load / idle),
        variance=waiting.variance * count * share * (1.0 - share) / free / (load / idle**2),
        none=min(1.0, waiting.none * (1.0 - share) ** count / idle),
    )


def _compute_variance_of_one_core(work: float, burst: float, load: float) -> float:
    """Variance of the sojourn time of a job of ``work`` s in M/M/1 with processor sharing (Yashkov 1983)."""
    idle = 1.0 - load
    scaled = idle * work / burst
    if scaled < 1e-4:  # the difference below is lost in rounding: its limit for short jobs
        return load * work**2 / idle**2
    return 2.0 * load * burst**2 / idle**4 * (scaled + expm1(-scaled))


@lru_cache(maxsize=65_536)
def compute_waiting_quantile(waiting: Waiting, share: float) -> float:
    """The waiting (s) that ``share`` of the jobs do not exceed.

    Nothing for those that do not wait; of the others a gamma distribution with the same mean and variance,
    with the quantile of Wilson and Hilferty.
    """
    if share <= waiting.none or waiting.mean <= 0.0:
        return 0.0
    waits = 1.0 - waiting.none
    mean = waiting.mean / waits
    variance = (waiting.variance + waiting.mean**2) / waits - mean**2
    if variance <= 0.0:
        return mean
    shape = mean**2 / variance
    normal = _NORMAL.inv_cdf((share - waiting.none) / waits)
    return mean * max(0.0, 1.0 - 1.0 / (9.0 * shape) + normal / (3.0 * sqrt(shape))) ** 3


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
        """Spreads of independent times add up by their squares."""
        own = median * (longer ** (_NORMAL.inv_cdf(share) / _Z95) - 1.0)
        waits = min(longest, compute_waiting_quantile(waiting, share))
        return _MS * (median + transfer + rtt + (hypot(own, waits) if own > 0.0 else own + waits))

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
