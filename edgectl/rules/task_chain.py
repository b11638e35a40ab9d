# SPDX-License-Identifier: Apache-2.0
"""Waiting of a job among a few tasks that share the cores, by the chain of the busy ones (ADR 125). Pure.

Jobs of another task come at random and wait for each other, so the task is either idle or busy. The number of
busy ones is a birth and death process. A job of known length sees it in the time of its own work, where every
rate is divided by its share of a core (Coffman, Muntz and Trotter 1970; for a closed set of tasks Mitra
1981).
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

# Steps of the bisection for the rate of ends: to one part in 10^9.
_HALVES = 30
# The method of Runge and Kutta is stable up to 2.78 of rate times step.
_STEADY = 2.0
_LEAST_STEPS = 4
_Vector = Sequence[float]


class Waiting(NamedTuple):
    """What waiting adds to a job: mean (s), variance (s^2); ``none``: the share of jobs that do not wait."""

    mean: float
    variance: float
    none: float


class Chain(NamedTuple):
    """By the number of busy others, from 0: its probability when the job comes (``presence``), and per second
    of the job's own work how many others begin (``begins``) and end (``ends``), and its waiting (``delays``).
    """

    presence: _Vector
    begins: _Vector
    ends: _Vector
    delays: _Vector


@lru_cache(maxsize=4096)
def compute_chain_waiting(others: int, cores: int, load: float, work: float) -> Waiting:
    """Moments of the waiting of a job of ``work`` among ``others`` tasks, at least as many as ``cores``.

    They use ``load`` (above 0, below 1) of each core with jobs whose mean length is the unit of time.
    """
    chain = build_chain(others, cores, load)
    first, second, alone = _integrate_moments(chain, work)
    mean, square, none = (_weigh(chain.presence, each) for each in (first, second, alone))
    return Waiting(mean, square - mean * mean, none)


def build_chain(others: int, cores: int, load: float) -> Chain:
    """The chain of ``others`` tasks: each begins at the rate of its jobs, and ends at the rate at which the
    cores do all the work that comes.
    """
    counts = range(others + 1)
    begin = load * cores / others
    low, end = 0.0, 1.0
    for _ in range(_HALVES):
        middle = (low + end) / 2.0
        busy = _weigh(_compute_presence(others, cores, begin / middle), [min(each, cores) for each in counts])
        low, end = (middle, end) if busy > load * cores else (low, middle)
    shares = [min(1.0, cores / (each + 1)) for each in counts]
    return Chain(
        presence=_compute_presence(others, cores, begin / end),
        begins=[(others - each) * begin / share for each, share in zip(counts, shares, strict=True)],
        ends=[each * end for each in counts],
        delays=[1.0 / share - 1.0 for share in shares],
    )


def _compute_presence(others: int, cores: int, ratio: float) -> list[float]:
    """Probability of each number of busy tasks without the job, for this ``ratio`` of begins to ends."""
    weights = [1.0]
    for count in range(1, others + 1):
        weights.append(weights[-1] * (others - count + 1) * ratio / min(count, cores))
    whole = sum(weights)
    return [each / whole for each in weights]


def _integrate_moments(chain: Chain, work: float) -> tuple[_Vector, _Vector, _Vector]:
    """Mean and mean square of the waiting, and the probability of none, by the number of others at its begin.

    Backward equations of the chain over ``work``, by the method of Runge and Kutta of fourth order.
    """
    rate = max(begin + end for begin, end in zip(chain.begins, chain.ends, strict=True))
    steps = max(_LEAST_STEPS, int(rate * work / _STEADY) + 1)
    size = work / steps
    delays = chain.delays
    first = second = [0.0] * len(delays)
    alone = [float(not each) for each in delays]

    def grow(state: tuple[_Vector, ...]) -> tuple[_Vector, ...]:
        first, second, alone = state
        return (
            [flow + delay for flow, delay in zip(_flow(chain, first), delays, strict=True)],
            [
                flow + 2.0 * delay * mean
                for flow, delay, mean in zip(_flow(chain, second), delays, first, strict=True)
            ],
            [0.0 if delay else flow for flow, delay in zip(_flow(chain, alone), delays, strict=True)],
        )

    state: tuple[_Vector, ...] = (first, second, alone)
    for _ in range(steps):
        state = _step(grow, state, size)
    return state[0], state[1], state[2]


def _flow(chain: Chain, values: _Vector) -> list[float]:
    """The generator of the chain on a function of the number of others."""
    above, below = [*values[1:], values[-1]], [values[0], *values[:-1]]
    return [
        begin * (more - here) + end * (less - here)
        for begin, end, here, more, less in zip(chain.begins, chain.ends, values, above, below, strict=True)
    ]


def _step(
    grow: Callable[[tuple[_Vector, ...]], tuple[_Vector, ...]], state: tuple[_Vector, ...], size: float
) -> tuple[_Vector, ...]:
    def ahead(slope: tuple[_Vector, ...], by: float) -> tuple[_Vector, ...]:
        return tuple(
            [value + by * each for value, each in zip(values, slopes, strict=True)]
            for values, slopes in zip(state, slope, strict=True)
        )

    one = grow(state)
    two = grow(ahead(one, size / 2.0))
    three = grow(ahead(two, size / 2.0))
    four = grow(ahead(three, size))
    mean = tuple(
        [(a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(*each, strict=True)]
        for each in zip(one, two, three, four, strict=True)
    )
    return ahead(mean, size)


def _weigh(weights: _Vector, values: _Vector) -> float:
    return sum(weight * value for weight, value in zip(weights, values, strict=True))
