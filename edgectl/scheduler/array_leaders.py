# SPDX-License-Identifier: Apache-2.0
"""Totals of a task that starts, at every place at once, and the two places that lead them (ADR 147). Pure.

Where totals are equal within the tolerance, the tie rule of ``ties`` decides here too (ADR 160), on terms as
the scan has them. They differ from the reference by rounding: where that may decide, nobody leads, and the
task is weighed in full.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field
from typing import NamedTuple

import numpy as np

from edgectl.dataclass import dataclass
from edgectl.model.policy import Preference
from edgectl.model.resource import AFFINITY, LATENCY, NETWORK, RATING
from edgectl.model.task import Task
from edgectl.scheduler.array_scan import ArrayScan, ArrayTotals, FreeArrays, fill_link_terms
from edgectl.scheduler.array_types import Array, Indexes
from edgectl.scheduler.candidates import AssignmentContext
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.ranking import SHORT_RANKING, is_ranking_full
from edgectl.scheduler.scan import EXCLUDED_TOTAL, is_feasible_total
from edgectl.scheduler.ties import is_free_share_weighed, rank_sums
from edgectl.scheduler.utility import EPSILON, compute_affinity

# A term of this or more fits by the scan as well as by the reference, however they round.
LEAST_TERM = -EPSILON / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class StartTotals:
    """Whatever the totals of all starts of one pass have in common.

    ``placed``: how many tasks the pass has put on each place so far. ``utilities``: UT_task by reward, by the
    number of predecessors and the rewards. ``totals`` by place, of which ``edges`` is the part of the edges,
    and ``links``, UT_net by edge, are of the last task, as is ``scratch``. ``weighs_near``, ``weighs_far``:
    whether sums of terms decide ties, of tasks with predecessors and without.
    """

    context: AssignmentContext
    arrays: ArrayScan
    free: FreeArrays
    placed: Mapping[int, int]
    totals: ArrayTotals
    edges: Array
    links: Array
    scratch: Array
    weighs_near: bool
    weighs_far: bool
    utilities: dict[tuple[int, ...], Mapping[int, float]] = field(default_factory=dict)


def build_start_totals(
    context: AssignmentContext, ledger: Ledger, placed: Mapping[int, int]
) -> StartTotals | None:
    """Totals of the tasks that a pass with ``ledger`` starts; None where they alone never decide."""
    policy, fleet = context.policy, context.fleet
    others = (LATENCY, RATING, *(name for name in ledger.used if name not in fleet.counted))
    plain = policy.prefer is not Preference.PACK and context.rules.edges
    plain = plain and not any(policy.weights[name] for name in others)
    if context.arrays is None or ledger.mirror is None or not plain:
        return None
    row: Array = np.full(len(fleet.places), EXCLUDED_TOTAL)
    return StartTotals(
        context=context,
        arrays=context.arrays,
        free=ledger.mirror,
        placed=placed,
        totals=ArrayTotals(row),
        edges=row[: fleet.edges],
        links=np.empty(fleet.edges),
        scratch=np.empty(fleet.edges),
        weighs_near=is_free_share_weighed(context, (0,)),
        weighs_far=is_free_share_weighed(context, ()),
    )


def rate_places(
    start: StartTotals, located: tuple[int, ...], near: Collection[int], *, far: bool
) -> Mapping[int, float]:
    """UT_task by reward: of the places ``near`` predecessors, and of others if there are any (``far``)."""
    rewards = {compute_affinity(located, place) for place in near}
    if far:
        rewards.add(-len(located))
    key = len(located), *rewards
    found = start.utilities.get(key)
    if found is None:
        found = start.utilities[key] = start.context.rules.rate_affinity(rewards, len(located))
    return found


def fill_totals(
    start: StartTotals,
    task: Task,
    near: Collection[int],
    located: tuple[int, ...],
    utilities: Mapping[int, float],
) -> None:
    """Eq. (4) at every edge, whether the task fits there or not: see `ArrayScan.compute_totals`."""
    weights, shares, free = start.context.policy.weights, start.arrays.shares, start.free
    weight, far = weights[AFFINITY], utilities.get(-len(located), 0.0)
    row = start.totals.row
    totals = np.add(free.weighted, weight * far, out=start.edges)
    totals -= shares.weigh_hosts(task, start.arrays.weights)
    fill_link_terms(start.links, free, shares, task)
    totals += np.multiply(start.links, weights[NETWORK.name], out=start.scratch)
    for place in near:
        row[place] += weight * (utilities[compute_affinity(located, place)] - far)


class Leaders(NamedTuple):
    """The first place of a task and the second, if there is one."""

    first: int
    second: int | None


def find_leaders(start: StartTotals, task: Task, located: Sequence[int]) -> Leaders | None:
    """The leaders of ``task`` by its totals; None where they are not certain, or no place is feasible."""
    row = start.totals.row
    first = int(row.argmax())
    top, row[first] = row.item(first), EXCLUDED_TOTAL
    second = int(row.argmax())
    other, row[second] = row.item(second), EXCLUDED_TOTAL
    third = row.item(row.argmax())
    row[second], row[first] = other, top
    if not is_feasible_total(top):
        return None
    if not is_feasible_total(other):
        return Leaders(first, None)
    if other < top - EPSILON and third < other - 2 * EPSILON:
        return Leaders(first, second)
    return _find_tied_leaders(start, task, located, top, other)


def _find_tied_leaders(
    start: StartTotals, task: Task, located: Sequence[int], top: float, other: float
) -> Leaders | None:
    """The first two places (`choice.find_best_place`, `ranking.find_challenger`) where the greatest total
    ``top``, or the one after it, ``other``, is that of several places, within the tolerance.
    """
    row = start.totals.row
    window = (row >= other - 2 * EPSILON).nonzero()[0]
    terms = _list_terms(start, task, window)
    if min(map(min, terms)) < LEAST_TERM:
        return None
    places = window.tolist()
    totals = dict(zip(places, row.take(window).tolist(), strict=True))
    weighed = start.weighs_near if located else start.weighs_far
    sums = dict(zip(places, map(sum, zip(*terms, strict=True)), strict=True)) if weighed else {}
    tied = [place for place in places if totals[place] >= top - EPSILON]
    first = _choose_tied(start, tied, tied, sums)
    if first is None:
        return None
    second = _choose_rival(start, totals, first, sums)
    return None if second is None else Leaders(first, second)


def _list_terms(start: StartTotals, task: Task, places: Indexes) -> list[list[float]]:
    """UT of each resource that counts, one row each, at ``places``: lists, because these are few."""
    shares, _ = start.arrays.shares.of_hosts(task, start.arrays.weights)
    terms: Array = start.free.free.take(places, axis=1) - shares.take(places, axis=1)
    return [*terms.tolist(), start.links.take(places).tolist()]


def _choose_rival(
    start: StartTotals, totals: Mapping[int, float], first: int, sums: Mapping[int, float]
) -> int | None:
    """The place that comes next to ``first``; None where rounding may decide."""
    least = max(total for place, total in totals.items() if place != first) - 2 * EPSILON
    near = [place for place, total in totals.items() if total >= least or place == first]
    if len(near) > SHORT_RANKING and not is_ranking_full(start.context, range(start.context.fleet.edges)):
        near = sorted(near, key=totals.__getitem__, reverse=True)[:SHORT_RANKING]
    rivals = sorted(place for place in near if place != first)
    if len(rivals) == 1:
        return rivals[0]
    found = [totals[place] for place in rivals]
    gap = totals[first] - min(found)
    if max(found) - min(found) > EPSILON / 2 or EPSILON / 2 < gap <= 2 * EPSILON:
        return None
    return _choose_tied(start, rivals, [*rivals, first] if gap <= 2 * EPSILON else rivals, sums)


def _choose_tied(
    start: StartTotals, places: Sequence[int], tied: Sequence[int], sums: Mapping[int, float]
) -> int | None:
    """The first of ``places`` by the tie rule, among all that are ``tied``; None where rounding may decide.

    ``sums``: of the terms of resources by place; empty where they decide nothing.
    """
    if len(places) == 1:
        return places[0]
    ranks: Mapping[int, int] = {}
    counted = {place: sums[place] for place in tied} if sums else {}
    if counted and max(counted.values()) - min(counted.values()) > EPSILON / 2:
        ranks = rank_sums(counted, gap=EPSILON / 2)
        if ranks != rank_sums(counted, gap=2 * EPSILON):
            return None
    placed, order = start.placed, start.context.fleet.order
    return min(places, key=lambda place: (ranks.get(place, 0), placed.get(place, 0), order[place]))
