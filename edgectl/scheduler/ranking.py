"""What is recorded of a choice: every host's terms, losers and rejected ones included (DESIGN section 4)."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from edgectl.model.assignment import RankedHost, Rejection, RejectionRule, Terms
from edgectl.scheduler.candidates import CandidateSet, terms_at
from edgectl.scheduler.demand import list_resource_demands
from edgectl.scheduler.scan import INFEASIBLE_PENALTY
from edgectl.scheduler.utility import EPSILON, compute_affinity

# Above this many hosts a ranking keeps the winner, the incumbent and the best SHORT.
MAX_FULL_RANKING, SHORT_RANKING = 64, 16
_NO_TERMS = Terms(cpu=None, memory=None, network=None, task=None)


class ScoredPlace(NamedTuple):
    """One place as the reference computes it."""

    place: int
    total: float | None
    terms: Terms
    rejections: tuple[Rejection, ...]


def rank_hosts(view: CandidateSet, chosen: int | None) -> tuple[tuple[RankedHost, ...], dict[str, int]]:
    """The hosts of one task, best first, and how many rejected hosts were left out, by the rule that rejects them."""
    kept, left_out = _select_shown_places(view, chosen)
    weighed = [_score_place(view, place) for place in kept]
    feasible = _sort_by_total(view, [host for host in weighed if not host.rejections])
    order = view.setting.fleet.order
    rest = sorted(
        (host for host in weighed if host.rejections),
        key=lambda host: (host.total is None, -(host.total or 0.0), order[host.place]),
    )
    entries = [
        _build_ranked_host(view, host, _compute_rank(view, host, position))
        for position, host in enumerate(feasible, start=1)
    ]
    entries += [_build_ranked_host(view, host, 0) for host in rest]
    return tuple(entries), left_out


def _select_shown_places(view: CandidateSet, chosen: int | None) -> tuple[Sequence[int], dict[str, int]]:
    """The places that the ranking holds, and how many rejected ones it leaves out, by rule."""
    if len(view.listed) <= MAX_FULL_RANKING or view.setting.policy.full:
        return view.listed, {}
    totals = view.totals
    best = sorted(view.listed, key=totals.__getitem__, reverse=True)
    kept = {*best[:SHORT_RANKING], *(place for place in (chosen, view.incumbent) if place is not None)}
    fitting = bisect_left(best, INFEASIBLE_PENALTY / 2, key=lambda place: -totals[place])
    rules = Counter(_find_rejection_rule(view, place) for place in best[fitting:] if place not in kept)
    return sorted(kept), dict(sorted(rules.items()))


def _score_place(view: CandidateSet, place: int) -> ScoredPlace:
    denied = view.denied.get(place)
    if denied is not None:
        return ScoredPlace(place, None, _NO_TERMS, (denied,))
    terms, total, rejections = terms_at(view, place)
    waived = (view.waived,) if view.waived is not None and place == view.incumbent else ()
    return ScoredPlace(place, total, terms, waived + rejections)


def _sort_by_total(view: CandidateSet, hosts: list[ScoredPlace]) -> list[ScoredPlace]:
    """Best total first; totals that are equal within EPSILON in the order of the tie rule, so that rank 1 is the argmax."""
    order = view.setting.fleet.order
    hosts.sort(key=lambda host: (-(host.total or 0.0), order[host.place]))
    groups: list[list[ScoredPlace]] = []
    for host in hosts:
        if groups and (groups[-1][0].total or 0.0) - (host.total or 0.0) <= EPSILON:
            groups[-1].append(host)
        else:
            groups.append([host])
    for group in groups:
        group.sort(
            key=lambda host: (host.place != view.incumbent, view.placed.get(host.place, 0), order[host.place])
        )
    return [host for group in groups for host in group]


def _compute_rank(view: CandidateSet, host: ScoredPlace, position: int) -> int:
    """The position; an incumbent kept below a shortened ranking gets the position that it has among all."""
    if position <= SHORT_RANKING or len(view.listed) <= MAX_FULL_RANKING or view.setting.policy.full:
        return position
    return max(position, 1 + sum(total > view.totals[host.place] + EPSILON for total in view.totals))


def _build_ranked_host(view: CandidateSet, host: ScoredPlace, rank: int) -> RankedHost:
    fleet = view.setting.fleet
    return RankedHost(
        host=view.name(host.place),
        rank=rank,
        total=host.total,
        terms=host.terms,
        feasible=rank > 0,
        affinity=compute_affinity(view.located, host.place),
        rejections=host.rejections,
        demand=list_resource_demands(fleet, view.task, host.place) if view.task.name in fleet.demands else (),
    )


def _find_rejection_rule(view: CandidateSet, place: int) -> str:
    """Why a place was rejected, without the numbers."""
    denied = view.denied.get(place)
    if denied is not None:
        return denied.rule.value
    fleet = view.setting.fleet
    robots = view.task.robots if place < fleet.edges else ()
    links = [fleet.links[robot][place] if robot in fleet.links else None for robot in robots]
    if None in links:
        return RejectionRule.NO_LINK.value
    return (
        RejectionRule.NO_CAPACITY.value
        if 0.0 in (fleet.cpu[place], fleet.memory[place], *links)
        else RejectionRule.INSUFFICIENT.value
    )
