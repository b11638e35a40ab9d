# SPDX-License-Identifier: Apache-2.0
"""Order of places with equal totals (ADR 0008)."""

from collections.abc import Sequence

from edgectl.model.policy import Preference
from edgectl.model.resource import AFFINITY, NETWORK
from edgectl.scheduler.candidates import CandidateSet, resource_terms_at
from edgectl.scheduler.utility import EPSILON


def order_tied_places(candidates: CandidateSet, places: Sequence[int]) -> list[int]:
    """Places of equal total, the one to choose first: incumbent, greatest sum of the resource terms (least
    where full hosts are preferred), fewest tasks placed in this pass, natural order.
    """
    order, levels = candidates.context.fleet.order, _rank_free_shares(candidates, places)
    return sorted(
        places,
        key=lambda place: (
            place != candidates.incumbent,
            levels.get(place, 0),
            candidates.placed.get(place, 0),
            order[place],
        ),
    )


def _rank_free_shares(candidates: CandidateSet, places: Sequence[int]) -> dict[int, int]:
    """The rank of each place by the sum of its resource terms; empty where equal totals imply equal sums."""
    weights = candidates.context.policy.weights
    counted = (*candidates.context.fleet.counted, NETWORK.name)
    alike = {weights[name] for name in counted}
    if len(alike) == 1 and 0.0 not in alike and (not candidates.located or not weights[AFFINITY]):
        return {}
    sums = {place: _sum_resource_terms(candidates, place) for place in places}
    levels: dict[int, int] = {}
    level, last = 0, None
    packs = candidates.context.policy.prefer is Preference.PACK
    for place in sorted(places, key=sums.__getitem__, reverse=not packs):
        if last is not None and abs(last - sums[place]) > EPSILON:
            level += 1
        levels[place], last = level, sums[place]
    return levels


def _sum_resource_terms(candidates: CandidateSet, place: int) -> float:
    terms, _ = resource_terms_at(candidates, place)
    return sum(term for term in terms.values() if term is not None)
