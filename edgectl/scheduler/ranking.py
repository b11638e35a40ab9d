# SPDX-License-Identifier: Apache-2.0
"""Ranking of the hosts of one task, with the terms of every host, losing and rejected ones included."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Sequence
from typing import NamedTuple

from edgectl.model.assignment import RankedHost, Rejection, RejectionRule, UtilityTerms
from edgectl.scheduler.candidates import AssignmentContext, CandidateSet, Totals, latency_at, terms_at
from edgectl.scheduler.demand import list_resource_demands
from edgectl.scheduler.scan import EXCLUDED_TOTAL, INFEASIBLE_PENALTY, is_feasible_total
from edgectl.scheduler.ties import choose_tied_place, order_tied_places
from edgectl.scheduler.utility import EPSILON, compute_affinity

# Above this many hosts a ranking keeps the winner, the incumbent and the best SHORT.
MAX_FULL_RANKING, SHORT_RANKING = 64, 16
_NO_TERMS = UtilityTerms()


class ScoredPlace(NamedTuple):
    """One place as the reference computes it."""

    place: int
    total: float | None
    terms: UtilityTerms
    rejections: tuple[Rejection, ...]


def rank_hosts(candidates: CandidateSet, chosen: int | None) -> tuple[tuple[RankedHost, ...], dict[str, int]]:
    """The hosts of one task, best first, and how many rejected hosts were left out, by the rule that rejects
    them.
    """
    kept, left_out = _select_shown_places(candidates, chosen)
    weighed = [score_place(candidates, place) for place in kept]
    feasible = _sort_by_total(candidates, [host for host in weighed if not host.rejections])
    order = candidates.context.fleet.order
    rest = sorted(
        (host for host in weighed if host.rejections),
        key=lambda host: (host.total is None, -(host.total or 0.0), order[host.place]),
    )
    entries = [
        _build_ranked_host(candidates, host, _compute_rank(candidates, host, position))
        for position, host in enumerate(feasible, start=1)
    ]
    entries += [_build_ranked_host(candidates, host, 0) for host in rest]
    return tuple(entries), left_out


def find_challenger(candidates: CandidateSet, chosen: int | None) -> ScoredPlace | None:
    """The feasible host that the ranking lists first besides ``chosen``; None: there is none."""
    others = exclude_places(candidates, () if chosen is None else (chosen,))
    second = others.find_top()
    if second is None:
        return None
    # The ranking orders equal totals by the tie rule: those that may be equal to the second are looked at.
    near = others.list_at_least(others[second] - 2 * EPSILON, second)
    if len(near) == 1:
        return score_place(candidates, second)
    if chosen is not None and is_feasible_total(candidates.totals[chosen]):
        near.append(chosen)
    near.sort()
    shown = (
        near
        if is_ranking_full(candidates.context, candidates.listed)
        else sorted(_keep_best(candidates, near, chosen))
    )
    first = _find_first_tied(candidates, shown, chosen)
    if first is not None and not first.rejections:
        return first
    weighed = [score_place(candidates, place) for place in shown]
    feasible = _sort_by_total(candidates, [host for host in weighed if not host.rejections])
    return next((host for host in feasible if host.place != chosen), None)


def _find_first_tied(
    candidates: CandidateSet, places: Sequence[int], chosen: int | None
) -> ScoredPlace | None:
    """The first of ``places`` besides ``chosen``, where their totals are so close that only the tie rule
    orders them; ``chosen`` may be far above them. None: that is not certain.
    """
    totals = [candidates.totals[place] for place in places if place != chosen]
    least, most = min(totals), max(totals)
    tied, gap = list(places), 0.0
    if len(totals) < len(places) and chosen is not None:
        gap = candidates.totals[chosen] - least
        if gap > 2 * EPSILON:
            tied.remove(chosen)
    if most - least > EPSILON / 2 or EPSILON / 2 < gap <= 2 * EPSILON:
        return None
    return score_place(candidates, choose_tied_place(candidates, tied, chosen))


def exclude_places(candidates: CandidateSet, places: Sequence[int]) -> Totals:
    """The totals without those of ``places``."""
    totals = candidates.totals.copy()
    for place in places:
        totals[place] = EXCLUDED_TOTAL
    return totals


def is_ranking_full(context: AssignmentContext, listed: Collection[int]) -> bool:
    """Whether a ranking of the places ``listed`` holds all of them."""
    return len(listed) <= MAX_FULL_RANKING or context.policy.full


def _keep_best(candidates: CandidateSet, places: Sequence[int], chosen: int | None) -> set[int]:
    """Those of ``places``, which hold the best, that a short ranking shows."""
    best = sorted(places, key=candidates.totals.__getitem__, reverse=True)
    return {*best[:SHORT_RANKING], *(place for place in best if place in (chosen, candidates.incumbent))}


def _select_shown_places(
    candidates: CandidateSet, chosen: int | None
) -> tuple[Sequence[int], dict[str, int]]:
    """The places that the ranking holds, and how many rejected ones it leaves out, by rule."""
    if is_ranking_full(candidates.context, candidates.listed):
        return candidates.listed, {}
    totals = candidates.totals
    best = sorted(candidates.listed, key=totals.__getitem__, reverse=True)
    kept = {*best[:SHORT_RANKING], *(place for place in (chosen, candidates.incumbent) if place is not None)}
    fitting = bisect_left(best, INFEASIBLE_PENALTY / 2, key=lambda place: -totals[place])
    rules = Counter(_find_rejection_rule(candidates, place) for place in best[fitting:] if place not in kept)
    return sorted(kept), dict(sorted(rules.items()))


def score_place(candidates: CandidateSet, place: int) -> ScoredPlace:
    """The reference terms, total and rejections of one place that a ranking lists."""
    denied = candidates.denied.get(place)
    if denied is not None:
        return ScoredPlace(place, None, _NO_TERMS, (denied,))
    terms, total, rejections = terms_at(candidates, place)
    if candidates.tolerated and place == candidates.incumbent:
        return ScoredPlace(place, total, terms, ())
    waived = (candidates.waived,) if candidates.waived is not None and place == candidates.incumbent else ()
    return ScoredPlace(place, total, terms, waived + rejections)


def _sort_by_total(candidates: CandidateSet, hosts: list[ScoredPlace]) -> list[ScoredPlace]:
    """Best total first.

    Totals that are equal within EPSILON in the order of the tie rule, so that rank 1 is the argmax.
    """
    order = candidates.context.fleet.order
    hosts.sort(key=lambda host: (-(host.total or 0.0), order[host.place]))
    groups: list[list[ScoredPlace]] = []
    for host in hosts:
        if groups and (groups[-1][0].total or 0.0) - (host.total or 0.0) <= EPSILON:
            groups[-1].append(host)
        else:
            groups.append([host])
    for group in groups:
        if len(group) > 1:
            position = {
                place: at
                for at, place in enumerate(order_tied_places(candidates, [host.place for host in group]))
            }
            group.sort(key=lambda host: position[host.place])
    return [host for group in groups for host in group]


def _compute_rank(candidates: CandidateSet, host: ScoredPlace, position: int) -> int:
    """The position; an incumbent kept below a shortened ranking gets the position that it has among all."""
    if position <= SHORT_RANKING or is_ranking_full(candidates.context, candidates.listed):
        return position
    return max(
        position, 1 + sum(total > candidates.totals[host.place] + EPSILON for total in candidates.totals)
    )


def _build_ranked_host(candidates: CandidateSet, host: ScoredPlace, rank: int) -> RankedHost:
    fleet = candidates.context.fleet
    return RankedHost(
        host=candidates.name(host.place),
        rank=rank,
        total=host.total,
        terms=host.terms,
        feasible=rank > 0,
        affinity=compute_affinity(candidates.located, host.place),
        rejections=host.rejections,
        demand=list_resource_demands(fleet, candidates.task, host.place)
        if candidates.task.name in fleet.demands
        else (),
        predicted_latency=latency_at(candidates, host.place) if host.total is not None else None,
    )


def _find_rejection_rule(candidates: CandidateSet, place: int) -> str:
    """The rule that rejected a place, without the numbers."""
    denied = candidates.denied.get(place)
    if denied is not None:
        return denied.rule.value
    fleet = candidates.context.fleet
    robots = candidates.task.robots if place < fleet.edges else ()
    links = [fleet.links[robot][place] if robot in fleet.links else None for robot in robots]
    if None in links:
        return RejectionRule.NO_LINK.value
    return (
        RejectionRule.NO_CAPACITY.value
        if 0.0 in (*(row[place] for row in fleet.usable.values()), *links)
        else RejectionRule.INSUFFICIENT.value
    )
