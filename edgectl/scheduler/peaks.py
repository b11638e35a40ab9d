# SPDX-License-Identifier: Apache-2.0
"""Bounds that show at a glance that a running task stays: no host can beat its own by the margin (ADR 0075).

A pass that repeats a plan asks this for every task, and nearly always the answer is yes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from edgectl.model.policy import Preference, Weights
from edgectl.model.resource import AFFINITY, LATENCY, NETWORK, RATING
from edgectl.model.task import Task
from edgectl.scheduler.candidates import AssignmentContext, CandidateSet, get_edge_rejections, terms_at
from edgectl.scheduler.latency import is_latency_weighed
from edgectl.scheduler.ledger import NO_FREE_SHARE, Ledger
from edgectl.scheduler.utility import compute_affinity


@dataclass(slots=True, kw_only=True)
class LoadPeaks:
    """The most that is free on any edge, valid while no task has left its place in the pass.

    ``weighted``: the greatest ``Ledger.weigh_free``; ``links``: the greatest free share of a link, by robot.
    Each is found when first asked for. ``valid``: False once a task has left.
    """

    weighted: float | None = None
    links: dict[str, float] = field(default_factory=dict)
    valid: bool = True


def stays_by_room(
    context: AssignmentContext,
    ledger: Ledger,
    task: Task,
    here: int,
    located: Sequence[int],
    peaks: LoadPeaks,
) -> bool:
    """`stays_in_place` of a task at the edge ``here`` beside all its predecessors (``located``), if any:
    without candidates, because only room can then speak for another edge.
    """
    fleet, weights = context.fleet, context.policy.weights
    if located.count(here) < len(located) or not _decides_by_room(context, task) or here >= fleet.edges:
        return False
    if context.rules.robot_of(fleet, task) is not None or here in get_edge_rejections(context, task):
        return False
    link = peak = 1.0
    for robot in task.robots:
        row = ledger.free_links.get(robot)
        if row is None:
            return False
        link, peak = min(link, row[here]), min(peak, _find_link_peak(ledger, peaks, robot))
    if link < 0.0 or min([ledger.free[name][here] for name in fleet.counted]) < 0.0:
        return False
    gain = _find_weighted_peak(ledger, peaks, weights) - ledger.weigh_free(weights)[here]
    return gain + weights[NETWORK.name] * (peak - link) <= context.policy.move_margin


def _decides_by_room(context: AssignmentContext, task: Task) -> bool:
    """Whether room and predecessors alone decide where ``task`` goes, and the margin whether it moves."""
    policy = context.policy
    return (
        policy.prefer is not Preference.PACK  # there a demand raises the total
        and task.name not in context.handoffs.downtimes
        and policy.weights[LATENCY] == 0.0
        and policy.weights[RATING] == 0.0
        and not is_latency_weighed(policy, task)
    )


def stays_in_place(candidates: CandidateSet, peaks: LoadPeaks) -> bool:
    """Whether the task is certain to stay by policy utility: its host is feasible, and no other total can be
    greater by more than ``move_margin``.

    ``candidates`` need no totals, and their ledger still holds the task's own load: then the free shares of
    its host are its terms. False says nothing.
    """
    here, context = candidates.incumbent, candidates.context
    if (
        not peaks.valid
        or here is None
        or here in candidates.denied
        or not _decides_by_room(context, candidates.task)
    ):
        return False
    total = _compute_present_total(candidates, here)
    return (
        total is not None and _bound_best_total(candidates, peaks, here) - total <= context.policy.move_margin
    )


def _compute_present_total(candidates: CandidateSet, here: int) -> float | None:
    """Eq. (4) at ``here``, which holds the task's load; None where something is lacking there."""
    context, ledger = candidates.context, candidates.ledger
    weights = context.policy.weights
    link = 1.0
    for robot in candidates.task.robots if here < context.fleet.edges else ():
        row = ledger.free_links.get(robot)
        link = min(link, NO_FREE_SHARE if row is None else row[here])
    if link < 0.0 or min([row[here] for row in ledger.free.values()]) < 0.0:
        return None
    utility = candidates.utilities[compute_affinity(candidates.located, here)]
    return ledger.weigh_free(weights)[here] + weights[NETWORK.name] * link + weights[AFFINITY] * utility


def _bound_best_total(candidates: CandidateSet, peaks: LoadPeaks, here: int) -> float:
    """No total of a place besides ``here`` is greater: the demand is left out there, which only lowers it."""
    context, ledger = candidates.context, candidates.ledger
    weights, edges = context.policy.weights, context.fleet.edges
    free = ledger.weigh_free(weights)
    far = candidates.utilities.get(-len(candidates.located), 0.0)
    links = min([_find_link_peak(ledger, peaks, robot) for robot in candidates.task.robots], default=1.0)
    bounds = [
        _find_weighted_peak(ledger, peaks, weights) + weights[NETWORK.name] * links + weights[AFFINITY] * far
    ]
    for place in {*candidates.located} - {here}:
        if place < edges and place not in candidates.denied:
            utility = candidates.utilities[compute_affinity(candidates.located, place)]
            link = 1.0
            for robot in candidates.task.robots:
                row = ledger.free_links.get(robot)
                link = link if row is None else min(link, row[place])
            bounds.append(free[place] + weights[NETWORK.name] * link + weights[AFFINITY] * utility)
    robots = [place for place in candidates.robots if place != here and place not in candidates.denied]
    bounds += [terms_at(candidates, place)[1] or 0.0 for place in robots]
    return max(bounds)


def _find_weighted_peak(ledger: Ledger, peaks: LoadPeaks, weights: Weights) -> float:
    if peaks.weighted is None:
        peaks.weighted = max(ledger.weigh_free(weights)[: ledger.fleet.edges], default=NO_FREE_SHARE)
    return peaks.weighted


def _find_link_peak(ledger: Ledger, peaks: LoadPeaks, robot: str) -> float:
    peak = peaks.links.get(robot)
    if peak is None:
        peak = max(ledger.free_links.get(robot, ()), default=NO_FREE_SHARE)
        peaks.links[robot] = peak
    return peak
