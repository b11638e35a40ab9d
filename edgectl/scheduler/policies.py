"""Policies: the schemes of the paper's comparison, each with its own exceptions (ADR 0015)."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Reason, Verdict
from edgectl.model.policy import PolicyName
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


def choose_static(candidates: CandidateSet, constraints: MoveConstraints) -> Choice:
    """The present place; else the pin; else the first placement ever; else the best by utility.

    Never moved.
    """
    if candidates.incumbent is not None:
        return Choice(verdict=Verdict.KEPT, reason=Reason.NEVER_MOVED, place=candidates.incumbent)
    pin, first = candidates.task.hosts.pin, candidates.context.first.get(candidates.task.name)
    place = candidates.context.fleet.index.get(pin or first or "")
    if place is None:
        return choose_by_utility(candidates, constraints)
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
    number may reverse a decision, so it can be explained. ``follows_pins``: of an operator (ADR 140).
    """

    candidates: CandidateRules
    choose: Callable[[CandidateSet, MoveConstraints], Choice]
    settles: bool = False
    strict_paper: bool = False
    weighs_moves: bool = False
    follows_pins: bool = True


_BY_RULES = CandidateRules(
    robot_of=find_onboard_robot, reject_robot=reject_by_rules, rate_affinity=task_utilities
)
POLICIES: Mapping[PolicyName, SchedulingPolicy] = MappingProxyType(
    {
        PolicyName.UTILITY: SchedulingPolicy(
            candidates=replace(_BY_RULES, tolerant=True),
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
        PolicyName.STATIC: SchedulingPolicy(candidates=_BY_RULES, choose=choose_static),
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
    }
)
