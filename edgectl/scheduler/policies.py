# SPDX-License-Identifier: Apache-2.0
"""Policies: the schemes of the comparison, each with its own exceptions (ADR 15, ADR 130)."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Reason, Verdict
from edgectl.model.policy import PolicyName, Weights
from edgectl.scheduler.baselines import (
    PlaceScore,
    choose_highest_score,
    choose_while_it_fits,
    score_draw,
    score_free_share,
    score_packing,
    score_turn,
)
from edgectl.scheduler.candidates import (
    CandidateRules,
    CandidateSet,
    find_first_robot,
    find_no_robot,
    find_onboard_robot,
    reject_by_rules,
    reject_every_robot,
    reject_other_robots,
    terms_at,
)
from edgectl.scheduler.choice import Choice, MoveConstraints, choose_by_utility
from edgectl.scheduler.utility import paper_task_utilities, task_utilities

# A choice for one task, within the constraints that keep running tasks in place.
ChoiceRule = Callable[[CandidateSet, MoveConstraints], Choice]


def choose_by_paper(candidates: CandidateSet, _: MoveConstraints) -> Choice:
    """Algorithm 1 to the letter: the highest total, whether it fits or not; of equal ones the first.

    The same host again is kept.
    """
    totals = {
        place: terms_at(candidates, place)[1] for place in candidates.listed if place not in candidates.denied
    }
    known = {place: total for place, total in totals.items() if total is not None}
    if not known:
        return _keep_or_unplace(candidates, Reason.NO_CANDIDATE)
    best = max(known, key=lambda place: (known[place], -candidates.context.fleet.order[place]))
    if best == candidates.incumbent:
        return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_BEST, place=best)
    return Choice(verdict=Verdict.PLACED, reason=Reason.BEST, place=best)


def choose_static(
    candidates: CandidateSet, constraints: MoveConstraints, *, choose_first: ChoiceRule = choose_by_utility
) -> Choice:
    """The present place; else the pin; else the first placement ever; else the choice of ``choose_first``.

    Never moved.
    """
    if candidates.incumbent is not None:
        return Choice(verdict=Verdict.KEPT, reason=Reason.NEVER_MOVED, place=candidates.incumbent)
    pin, first = candidates.task.hosts.pin, candidates.context.first.get(candidates.task.name)
    place = candidates.context.fleet.index.get(pin or first or "")
    if place is None:
        return choose_first(candidates, constraints)
    if place in candidates.denied or place not in candidates.listed:
        return Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_CANDIDATE, subject=candidates.name(place))
    return Choice(
        verdict=Verdict.PLACED, reason=Reason.PINNED if pin else Reason.FIRST_PLACEMENT, place=place
    )


def choose_local(candidates: CandidateSet, constraints: MoveConstraints) -> Choice:
    """Everything on its first robot, whatever that does to the robot; a task without one has no place."""
    robots = [place for place in candidates.robots if place not in candidates.denied]
    if not robots:
        return _keep_or_unplace(candidates, Reason.NO_CANDIDATE)
    if candidates.incumbent == robots[0]:
        return Choice(verdict=Verdict.KEPT, reason=Reason.ONBOARD_LOCAL, place=robots[0])
    if candidates.incumbent is not None and constraints.frozen:
        return Choice(verdict=Verdict.KEPT, reason=Reason.MOVES_FROZEN, place=candidates.incumbent)
    return Choice(verdict=Verdict.PLACED, reason=Reason.ONBOARD_LOCAL, place=robots[0])


def _keep_or_unplace(candidates: CandidateSet, reason: Reason) -> Choice:
    """No candidate at all: a running task stays where it is, another is unplaced."""
    if candidates.incumbent is not None:
        return Choice(verdict=Verdict.KEPT, reason=Reason.NOTHING_FITS, place=candidates.incumbent)
    return Choice(verdict=Verdict.UNPLACED, reason=reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class SchedulingPolicy:
    """One policy: its candidates, its eq. (5), and how it goes over the sequence.

    ``settles``: passes are repeated until one changes nothing. ``strict_paper``: a running task's own use
    stays in gamma, and only what ran before the pass is a predecessor. ``weighs_moves``: a change of one
    number may reverse a decision, so it can be explained. ``weights``: instead of those of the files.
    ``follows_pins``: of an operator (ADR 140). ``moves``: a running task may leave its place.
    """

    candidates: CandidateRules
    choose: ChoiceRule
    settles: bool = False
    strict_paper: bool = False
    weighs_moves: bool = False
    weights: Weights | None = None
    follows_pins: bool = True
    moves: bool = True


_BY_RULES = CandidateRules(
    robot_of=find_onboard_robot, reject_robot=reject_by_rules, rate_affinity=task_utilities
)
_TOLERANT = replace(_BY_RULES, tolerant=True)
# With these the total is the score of `score_free_share`.
_LEAST_LOADED_WEIGHTS = Weights(cpu=0.5, memory=0.5, network=0.0, task=0.0)


def _build_static_policy(score: PlaceScore, reason: Reason) -> SchedulingPolicy:
    """Tasks are placed once, by ``score``, and never moved."""
    return SchedulingPolicy(
        candidates=_BY_RULES,
        choose=partial(choose_static, choose_first=_choose_first_by(score, reason)),
        moves=False,
    )


def _choose_first_by(score: PlaceScore, reason: Reason) -> ChoiceRule:
    return lambda candidates, _constraints: choose_highest_score(candidates, score, reason)


POLICIES: Mapping[PolicyName, SchedulingPolicy] = MappingProxyType(
    {
        PolicyName.UTILITY: SchedulingPolicy(
            candidates=_TOLERANT,
            choose=choose_by_utility,
            settles=True,
            weighs_moves=True,
        ),
        PolicyName.PAPER: SchedulingPolicy(
            candidates=CandidateRules(
                robot_of=find_no_robot, reject_robot=reject_every_robot, rate_affinity=paper_task_utilities
            ),
            choose=choose_by_paper,
            strict_paper=True,
        ),
        PolicyName.STATIC: SchedulingPolicy(candidates=_BY_RULES, choose=choose_static, moves=False),
        PolicyName.STATIC_LEAST_LOADED: _build_static_policy(score_free_share, Reason.LEAST_LOADED),
        PolicyName.STATIC_IN_TURN: _build_static_policy(score_turn, Reason.IN_TURN),
        PolicyName.STATIC_RANDOM: _build_static_policy(score_draw, Reason.DRAWN),
        PolicyName.STATIC_PACK: _build_static_policy(score_packing, Reason.FULLEST),
        PolicyName.LOCAL: SchedulingPolicy(
            candidates=CandidateRules(
                robot_of=find_first_robot,
                reject_robot=reject_other_robots,
                rate_affinity=task_utilities,
                edges=False,
            ),
            choose=choose_local,
            follows_pins=False,
        ),
        PolicyName.LEAST_LOADED: SchedulingPolicy(
            candidates=_TOLERANT, choose=choose_by_utility, weights=_LEAST_LOADED_WEIGHTS
        ),
        PolicyName.PACK: SchedulingPolicy(
            candidates=_TOLERANT,
            choose=partial(choose_while_it_fits, score=score_packing, reason=Reason.FULLEST),
        ),
        PolicyName.RANDOM: SchedulingPolicy(
            candidates=_TOLERANT,
            choose=partial(choose_while_it_fits, score=score_draw, reason=Reason.DRAWN),
        ),
    }
)
