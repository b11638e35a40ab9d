# SPDX-License-Identifier: Apache-2.0
"""Order of places with equal totals (ADR 0008)."""

from collections.abc import Collection, Mapping, Sequence

from edgectl.model.policy import Preference
from edgectl.model.resource import AFFINITY, NETWORK
from edgectl.scheduler.candidates import AssignmentContext, CandidateSet, resource_terms_at
from edgectl.scheduler.utility import EPSILON


def choose_tied_place(candidates: CandidateSet, places: Sequence[int], besides: int | None = None) -> int:
    """The first of ``places`` besides one in the order of `order_tied_places`; there is at least one.

    It leaves out those that are behind, a rule at a time: a sort would make a key for each of hundreds.
    """
    ranks = _rank_free_shares(candidates, places)
    left = [place for place in places if place != besides]
    if candidates.incumbent in left:
        return candidates.incumbent
    for counts in (ranks, candidates.placed):
        if counts:
            found = [counts.get(place, 0) for place in left]
            least = min(found)
            left = [place for place, count in zip(left, found, strict=True) if count == least]
    return min(left, key=candidates.context.fleet.order.__getitem__)


def order_tied_places(candidates: CandidateSet, places: Sequence[int]) -> list[int]:
    """Places of equal total, the one to choose first: incumbent, greatest sum of the resource terms (least
    where full hosts are preferred), fewest tasks placed in this pass, natural order.
    """
    order, ranks = candidates.context.fleet.order, _rank_free_shares(candidates, places)
    return sorted(
        places,
        key=lambda place: (
            place != candidates.incumbent,
            ranks.get(place, 0),
            candidates.placed.get(place, 0),
            order[place],
        ),
    )


def _rank_free_shares(candidates: CandidateSet, places: Sequence[int]) -> dict[int, int]:
    """The rank of each place by the sum of its resource terms; empty where they decide nothing."""
    if not is_free_share_weighed(candidates.context, candidates.located):
        return {}
    sums = {place: _sum_resource_terms(candidates, place) for place in places}
    return rank_sums(sums, packs=candidates.context.policy.prefer is Preference.PACK)


def is_free_share_weighed(context: AssignmentContext, located: Collection[int]) -> bool:
    """Whether places of equal totals may have other sums of resource terms; ``located``: predecessors."""
    weights = context.policy.weights
    alike = {weights[name] for name in (*context.fleet.counted, NETWORK.name)}
    return len(alike) > 1 or 0.0 in alike or bool(located and weights[AFFINITY])


def rank_sums(sums: Mapping[int, float], *, packs: bool = False, gap: float = EPSILON) -> dict[int, int]:
    """The rank of each place by its sum, the greatest first (``packs``: the least); one that is no more than
    ``gap`` after another has the same.
    """
    ranks: dict[int, int] = {}
    rank, last = 0, None
    for place in sorted(sums, key=sums.__getitem__, reverse=not packs):
        if last is not None and abs(last - sums[place]) > gap:
            rank += 1
        ranks[place], last = rank, sums[place]
    return ranks


def _sum_resource_terms(candidates: CandidateSet, place: int) -> float:
    terms, _ = resource_terms_at(candidates, place)
    return sum(term for term in terms.values() if term is not None)
