# SPDX-License-Identifier: Apache-2.0
"""Waiting of a job that shares cores with others: moments and percentiles (ADR 119, ADR 125). Pure.

docs/concepts/predicted-latency.md says what each formula is exact for.
"""

from functools import lru_cache
from math import exp, expm1, inf, sqrt
from statistics import NormalDist

from edgectl.rules.task_chain import Waiting, compute_chain_waiting

# Above this share of the capacity no queue is steady: a higher load counts as this one.
MAX_LOAD = 0.98
# The largest chain of tasks that is solved: cores, and tasks beyond them.
CHAIN_CORES, CHAIN_TASKS = 4, 16
NO_WAITING = Waiting(0.0, 0.0, 1.0)
# Loads per core at which chains are solved, between 0 and 1.
_TABLE = 25
_NORMAL = NormalDist()


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
    length = work / burst
    mean = length * busy / (cores * idle)
    alone = _compute_variance_of_one_core(length / cores, 1.0 / cores, load)
    mean_alone = length / cores * load / idle
    last_core = busy * idle / load / (1.0 - busy)
    waiting = Waiting(
        mean=mean,
        variance=busy / load * (alone + mean_alone**2) - mean**2,
        none=(1.0 - busy) * exp(-load * cores * last_core * length),
    )
    if others < inf:
        waiting = _limit_others(waiting, length, cores, load, others)
    return Waiting(waiting.mean * burst, waiting.variance * burst**2, waiting.none)


def _limit_others(many: Waiting, length: float, cores: int, load: float, others: float) -> Waiting:
    """The waiting among ``others`` tasks by their chain (ADR 125); ``many``: among very many.

    Lengths and times are in mean jobs of others. The chain is solved at two loads of a table around ``load``,
    for at most `CHAIN_CORES` cores and `CHAIN_TASKS` tasks beyond them. More cores or tasks: in the ratio of
    such a chain to very many, where what it lacks falls as 1 / others.
    """
    few, beyond = min(cores, CHAIN_CORES), int(others) - cores
    solved = min(beyond, CHAIN_TASKS)
    below = min(int(load * _TABLE), _TABLE - 1)
    low, high = below / _TABLE, min(MAX_LOAD, (below + 1) / _TABLE)
    part = (load - low) / (high - low)
    less, more = (_solve_chain(few + solved, few, each, length) for each in (low, high))
    chain = Waiting(*(below + part * (above - below) for below, above in zip(less, more, strict=True)))
    if few == cores and solved == beyond:
        return chain
    alike = many if few == cores else compute_waiting(length, 1.0, few, load)
    kept = (solved + 1) / (beyond + 1)
    return Waiting(
        mean=many.mean * (1.0 + kept * (chain.mean / alike.mean - 1.0)),
        variance=many.variance * (1.0 + kept * (chain.variance / alike.variance - 1.0)),
        none=1.0 - (1.0 - many.none) * (1.0 + kept * ((1.0 - chain.none) / (1.0 - alike.none) - 1.0)),
    )


def _solve_chain(others: int, cores: int, load: float, length: float) -> Waiting:
    return compute_chain_waiting(others, cores, load, length) if load else NO_WAITING


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
