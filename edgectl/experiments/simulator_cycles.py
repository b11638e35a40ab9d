# SPDX-License-Identifier: Apache-2.0
"""Tasks that work on one item after the other: their rates on hosts and links that they share. Pure.

A closed queueing network with one customer per task, solved by approximate mean value analysis (P. J.
Schweitzer, "Approximate analysis of multiclass closed networks of queues", 1979): each task has an item made,
fetches it over a link, works on it, and waits until the next one is due. Links share fairly (processor
sharing). A host may spend its cores in bursts, as a control group with a quota does: ``cores`` times the
period are there at once when a period begins, and whoever has used them up waits for the next one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

_ROUNDS, _TOLERANCE, _DAMPING = 200, 1e-6, 0.5
# Times are known to 1e-6 of the time between two items, and to this share of themselves.
_TIME_TOLERANCE = 1e-3
# Moments of a period, as a share of it, at which an item may come.
_PHASES = tuple((number + 0.5) / 16 for number in range(16))
# No host and no link is ever so slow that its queue is endless.
_LEAST_SHARE = 1e-3


class Station(NamedTuple):
    """A host or a link. ``capacity``: cores, or bytes/s. ``width``: how much of it one customer can use.

    ``period``: of the quota of a host (s); 0: none. ``rivals``: processes that want all of it all the time.
    """

    capacity: float
    width: float = math.inf
    period: float = 0.0
    rivals: int = 0


class Customer(NamedTuple):
    """A task of at most ``rate`` items/s. Each needs ``work`` (CPU s or bytes) of some stations."""

    rate: float
    work: tuple[tuple[int, float], ...]


class Flow(NamedTuple):
    """What a task achieves: items/s, and the age (s) of an item when it is done."""

    rate: float
    age: float


@dataclass(slots=True)
class _Estimate:
    """Rates of the customers, and their times (s) at the stations of their work. ``crowds``: by station, by
    what factor all stay longer because it gives no more than it has.
    """

    rates: list[float]
    times: list[list[float]]
    crowds: list[float]


@lru_cache(maxsize=8192)
def compute_flows(stations: tuple[Station, ...], customers: tuple[Customer, ...]) -> tuple[Flow, ...]:
    """The flow of each customer, in their order. The same system gives the same flows."""
    estimate = _Estimate(
        rates=[customer.rate for customer in customers],
        times=[[0.0] * len(customer.work) for customer in customers],
        crowds=[1.0] * len(stations),
    )
    for _ in range(_ROUNDS):
        if _improve(estimate, stations, customers) < _TOLERANCE:
            break
    return tuple(
        Flow(rate=rate, age=sum(times)) for rate, times in zip(estimate.rates, estimate.times, strict=True)
    )


def _improve(estimate: _Estimate, stations: Sequence[Station], customers: Sequence[Customer]) -> float:
    """Go half of the way to the times and rates that follow from the present ones; the largest change."""
    present, used = _sum_by_station(estimate, stations, customers)
    estimate.crowds = [
        max(1.0, crowd * share**_DAMPING) for crowd, share in zip(estimate.crowds, used, strict=True)
    ]
    largest = 0.0
    for customer, (number, times) in zip(customers, enumerate(estimate.times), strict=True):
        rate = estimate.rates[number]
        for place, (at, work) in enumerate(customer.work):
            others = max(0.0, present[at] - rate * times[place])
            share = min(1.0, max(0.0, used[at] - rate * work / stations[at].capacity))
            stay = compute_stay_s(stations[at], work, others, share, min(1.0, used[at]))
            change = estimate.crowds[at] * stay - times[place]
            times[place] += _DAMPING * change
            scale = max(customer.rate, _TOLERANCE / _TIME_TOLERANCE / times[place] if times[place] else 0.0)
            largest = max(largest, abs(change) * scale)
        change = min(customer.rate, 1.0 / max(1e-9, sum(times))) - rate
        estimate.rates[number] += _DAMPING * change
        largest = max(largest, abs(change) / customer.rate)
    return largest


def _sum_by_station(
    estimate: _Estimate, stations: Sequence[Station], customers: Sequence[Customer]
) -> tuple[list[float], list[float]]:
    """By station: the mean number of customers that are there, and the share of it that they use."""
    present, used = [0.0] * len(stations), [0.0] * len(stations)
    for customer, rate, times in zip(customers, estimate.rates, estimate.times, strict=True):
        for (at, work), time in zip(customer.work, times, strict=True):
            present[at] += rate * time
            used[at] += rate * work / stations[at].capacity
    return present, used


def compute_stay_s(station: Station, work: float, others: float, used: float, busy: float) -> float:
    """Mean time (s) of a customer with this work at a station.

    ``others``: how many others are there in the mean. ``used``: the share of the station that they use;
    ``busy``: that all use, 0..1. Without a quota those who are there share it. With one, the work first takes
    what is left of the period at the moment at which it comes, and then of each period what others leave, or
    a fair share if that is more.
    """
    ahead = 1.0 + others + station.rivals
    if station.period <= 0.0 or station.capacity >= station.width:
        return work * max(1.0 / station.width, ahead / station.capacity)
    quota = station.capacity * station.period
    own = quota * max(0.0 if station.rivals else 1.0 - used, 1.0 / ahead, _LEAST_SHARE)
    stays = (
        _compute_burst_s(station, work, own, quota * _find_left(station, busy, phase), phase)
        for phase in _PHASES
    )
    return sum(stays) / len(_PHASES)


def _find_left(station: Station, busy: float, phase: float) -> float:
    """The share of the quota that is left at a moment of the period (0..1).

    Work on a busy host has waited for the period, and uses it up early; else it comes at any moment.
    """
    if station.rivals:
        return 0.0
    over = 1.0 - busy * (1.0 - station.capacity)
    return 1.0 - busy * min(1.0, phase / over)


def _compute_burst_s(station: Station, work: float, own: float, now: float, phase: float) -> float:
    """Time of work that comes at this moment: ``now`` is left of this period, ``own`` comes with each one."""
    rest = (1.0 - phase) * station.period
    alone = work / station.width
    if work <= now:
        return alone
    missing = work - min(now, rest * station.width)
    whole = max(0, math.ceil(missing / own) - 1)
    return rest + whole * station.period + (missing - whole * own) / station.width
