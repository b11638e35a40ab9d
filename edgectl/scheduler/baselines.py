# SPDX-License-Identifier: Apache-2.0
"""Rules of other schedulers, as baselines to compare with (ADR 130): scores of places, and who uses them."""

from collections.abc import Callable
from hashlib import sha256

from edgectl.model.assignment import Reason, RejectionRule, Verdict
from edgectl.model.resource import CPU, MEMORY
from edgectl.scheduler.candidates import CandidateSet, resource_terms_at
from edgectl.scheduler.choice import Choice, MoveConstraints, choose_forced_move, choose_when_nothing_fits
from edgectl.scheduler.scan import is_feasible_total
from edgectl.scheduler.ties import choose_tied_place
from edgectl.scheduler.utility import EPSILON

# The score of one feasible place of a task: the greatest wins.
PlaceScore = Callable[[CandidateSet, int], float]

_MAX_PACKING, _LEAST_PACKED = 18.0, 20.0


def score_free_share(candidates: CandidateSet, place: int) -> float:
    """The mean of the shares of CPU and memory that are free once the task is there: at most 1.

    LeastAllocated of Kubernetes (NodeResourcesFit) with its default resources, on measured loads.
    """
    return sum(_list_free_shares(candidates, place)) / 2


def score_packing(candidates: CandidateSet, place: int) -> float:
    """20 - (10 ^ free CPU + 10 ^ free memory) in 0..18, shares once the task is there: 18 on a full host.

    ScoreFitBinPack of Nomad, which is BestFit v3 of a study at Google.
    """
    cpu, memory = _list_free_shares(candidates, place)
    emptiness: float = 10.0**cpu + 10.0**memory
    return min(_MAX_PACKING, max(0.0, _LEAST_PACKED - emptiness))


def _list_free_shares(candidates: CandidateSet, place: int) -> tuple[float, float]:
    terms, _ = resource_terms_at(candidates, place)
    return terms[CPU.name] or 0.0, terms[MEMORY.name] or 0.0


def score_turn(candidates: CandidateSet, place: int) -> float:
    """Round robin: the n-th task of the sequence looks from edge n on, each later edge is one worse.

    A robot comes after all edges.
    """
    edges = candidates.context.fleet.edges
    if place >= edges:
        return -float(edges)
    turn = candidates.context.turns.get(candidates.task.name, 0)
    return -float((place - turn) % edges)


def score_draw(candidates: CandidateSet, place: int) -> float:
    """A draw from 0..1 that the policy's seed, the task and the host decide.

    The greatest of such draws falls on each host with equal probability, and stays where it is when other
    hosts come and go (rendezvous hashing, Thaler and Ravishankar 1998).
    """
    seed, task = candidates.context.policy.seed, candidates.task.name
    digest = sha256(f"{seed}/{task}/{candidates.name(place)}".encode()).digest()
    return int.from_bytes(digest[:7], "big") / 2**56


def choose_highest_score(candidates: CandidateSet, score: PlaceScore, reason: Reason) -> Choice:
    """The feasible place with the greatest ``score`` for a task that starts.

    Ties: ``ties.choose_tied_place``.
    """
    best = _find_highest_score(candidates, score)
    if best is None:
        return choose_when_nothing_fits(candidates)
    return Choice(verdict=Verdict.PLACED, reason=reason, place=best)


def choose_while_it_fits(
    candidates: CandidateSet, constraints: MoveConstraints, *, score: PlaceScore, reason: Reason
) -> Choice:
    """As `choose_highest_score`; a running task moves only where it may not stay or does not fit."""
    here = candidates.incumbent
    if here is None:
        return choose_highest_score(candidates, score, reason)
    if is_feasible_total(candidates.totals[here]):
        return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_FITS, place=here)
    best = _find_highest_score(candidates, score)
    if best is not None:
        return choose_forced_move(candidates, best, here, constraints)
    rejection = candidates.denied.get(here)
    if rejection is not None and rejection.rule is RejectionRule.WITHOUT:
        return choose_when_nothing_fits(candidates)
    return Choice(verdict=Verdict.KEPT, reason=Reason.NOTHING_FITS, place=here)


def _find_highest_score(candidates: CandidateSet, score: PlaceScore) -> int | None:
    scores = {
        place: score(candidates, place)
        for place in candidates.listed
        if is_feasible_total(candidates.totals[place])
    }
    if not scores:
        return None
    top = max(scores.values())
    tied = [place for place, value in scores.items() if value >= top - EPSILON]
    return tied[0] if len(tied) == 1 else choose_tied_place(candidates, tied)
