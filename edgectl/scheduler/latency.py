# SPDX-License-Identifier: Apache-2.0
"""Predicted latency of a task at a place, its term of eq. (4), and the deadline as a rule (ADR 120). Pure."""

from collections.abc import Iterable, Iterator, Mapping
from math import inf
from typing import TYPE_CHECKING

from edgectl.model.assignment import Rejection, RejectionRule
from edgectl.model.policy import Policy
from edgectl.model.predicted_latency import PredictedLatency, ServiceTime
from edgectl.model.resource import CPU, LATENCY, MEMORY
from edgectl.model.task import Task
from edgectl.rules.measured_demand import classify_host
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.task_usage import TaskUsage

if TYPE_CHECKING:  # imported only where a task states what a prediction needs
    from edgectl.rules.latency import LinkLoad

# UT_latency where nothing is predicted: no host is then better than another.
NO_LATENCY_TERM = 1.0
_EVERY_CLASS = ""


def has_prediction(task: Task) -> bool:
    """Whether a latency is predicted for ``task``: its file states a deadline and a service time."""
    return task.deadline is not None and bool(task.service_time)


def is_latency_weighed(policy: Policy, task: Task) -> bool:
    """Whether the predicted latency of ``task`` decides anything."""
    return has_prediction(task) and (policy.weights[LATENCY] != 0.0 or task.hard_deadline)


def predict_latency(ledger: Ledger, task: Task, place: int, *, idle: bool = False) -> PredictedLatency | None:
    """Latency of a job of ``task`` at ``place``, whose gamma is without the task's own load.

    None: its file states no deadline or no service time, or the place has no capacity or no link. ``idle``:
    if nothing else ran there; no load makes it shorter.
    """
    fleet = ledger.fleet
    cores = fleet.raw[CPU.name][place]
    if not has_prediction(task) or not cores:
        return None
    from edgectl.rules.latency import HostLoad, estimate_latency

    service, elsewhere = _find_service_time(fleet, task, place)
    host = HostLoad(cores, 0.0 if idle else ledger.used[CPU.name][place], ledger.tasks[place] or inf)
    links = list(_list_links(ledger, task, place, idle=idle))
    if None in links:
        return None
    size = task.job.received + task.job.sent
    found = [estimate_latency(service, host, link, size, elsewhere=elsewhere) for link in links or [None]]
    return max(found, key=lambda each: each.p95_ms)


def _find_service_time(fleet: Capacities, task: Task, place: int) -> tuple[ServiceTime, bool]:
    """The service time of ``task`` at ``place``, and whether it is that of another class of hosts."""
    stated = task.service_time
    if _EVERY_CLASS not in stated or len(stated) > 1:
        kind = classify_host(fleet.places[place], fleet.raw[CPU.name][place], fleet.raw[MEMORY.name][place])
        if kind in stated:
            return stated[kind], False
    if _EVERY_CLASS in stated:
        return stated[_EVERY_CLASS], False
    return max(stated.values(), key=lambda each: (each.p95, each.p50)), True


def _list_links(ledger: Ledger, task: Task, place: int, *, idle: bool) -> "Iterator[LinkLoad | None]":
    """The links that a job crosses, None for one that is not there; on a robot's own computer none."""
    from edgectl.rules.latency import LinkLoad

    fleet = ledger.fleet
    sample = fleet.samples[place]
    for robot in task.robots if place < fleet.edges else ():
        row = fleet.links.get(robot)
        capacity = None if row is None else row[place]
        if not capacity or sample is None:
            yield None
            continue
        link = sample.links.get(robot)
        rtt = link.rtt_ms if link is not None and link.rtt_ms is not None else 0.0
        yield LinkLoad(capacity, 0.0 if idle else ledger.links[robot][place], rtt / 1000.0)


def rate_predicted_latency(task: Task, predicted: PredictedLatency | None) -> float:
    """UT_latency = (deadline - p95) / deadline, at least -1; 1 where nothing is predicted."""
    if predicted is None or task.deadline is None:
        return NO_LATENCY_TERM
    return max(-1.0, 1.0 - predicted.p95_ms / (1000.0 * task.deadline))


def reject_missed_deadline(task: Task, predicted: PredictedLatency | None) -> tuple[Rejection, ...]:
    """The rejection of a host where the p95 exceeds a hard deadline."""
    if not task.hard_deadline or predicted is None or task.deadline is None:
        return ()
    deadline_ms = 1000.0 * task.deadline
    if predicted.p95_ms <= deadline_ms:
        return ()
    return (Rejection(rule=RejectionRule.DEADLINE_MISSED, demand=predicted.p95_ms, capacity=deadline_ms),)


def list_latency_terms(
    ledger: Ledger, task: Task, places: Iterable[int]
) -> Iterator[tuple[int, float, bool]]:
    """Place, UT_latency, and whether a hard deadline is missed there, as the reference has them."""
    for place in places:
        predicted = predict_latency(ledger, task, place)
        missed = bool(reject_missed_deadline(task, predicted))
        yield place, rate_predicted_latency(task, predicted), missed


def may_keep_deadline(ledger: Ledger, task: Task, place: int) -> bool:
    """Whether ``task`` keeps a hard deadline at ``place`` if nothing else runs there."""
    return not task.hard_deadline or not reject_missed_deadline(
        task, predict_latency(ledger, task, place, idle=True)
    )


def count_missed_deadlines(
    tasks: Iterable[Task], placed: Mapping[str, tuple[int, TaskUsage]], ledger: Ledger
) -> int:
    """How many of ``tasks`` miss a hard deadline at the places of a plan; ``ledger``: gamma after it."""
    late, left = 0, None
    for task in tasks:
        if not task.hard_deadline or task.name not in placed:
            continue
        left = left or ledger.copy()
        place, use = placed[task.name]
        left.release(place, use)
        late += bool(reject_missed_deadline(task, predict_latency(left, task, place)))
        left.charge(place, use)
    return late
