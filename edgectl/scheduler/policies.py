"""The schemes of the paper's comparison: the same types, other rules (DESIGN section 5, ADR 0015)."""

from collections.abc import Callable, Mapping

from edgectl.model.assignment import Reason, Verdict
from edgectl.model.policy import PolicyName
from edgectl.scheduler.candidates import CandidateSet, terms_at
from edgectl.scheduler.choice import Choice, MoveConstraints, choose_by_utility


def choose_by_paper(view: CandidateSet, _: MoveConstraints) -> Choice:
    """Algorithm 1 to the letter: the highest total, whether it fits or not; of equal ones the first. The same host again is kept."""
    totals = {place: terms_at(view, place)[1] for place in view.listed if place not in view.denied}
    known = {place: total for place, total in totals.items() if total is not None}
    if not known:
        return _keep_or_unplace(view, Reason.NO_CANDIDATE)
    best = max(known, key=lambda place: (known[place], -view.setting.fleet.order[place]))
    if best == view.incumbent:
        return Choice(verdict=Verdict.KEPT, reason=Reason.STILL_BEST, place=best)
    return Choice(verdict=Verdict.PLACED, reason=Reason.BEST, place=best)


def choose_static(view: CandidateSet, brakes: MoveConstraints) -> Choice:
    """Where it runs; else its pin; else where it was first put; else the first placement by utility. Never moved."""
    if view.incumbent is not None:
        return Choice(verdict=Verdict.KEPT, reason=Reason.NEVER_MOVED, place=view.incumbent)
    pin, first = view.task.hosts.pin, view.setting.first.get(view.task.name)
    place = view.setting.fleet.index.get(pin or first or "")
    if place is None:
        return choose_by_utility(view, brakes)
    if place in view.denied or place not in view.listed:
        return Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_CANDIDATE, subject=view.name(place))
    return Choice(
        verdict=Verdict.PLACED, reason=Reason.PINNED if pin else Reason.FIRST_PLACEMENT, place=place
    )


def choose_local(view: CandidateSet, brakes: MoveConstraints) -> Choice:
    """Everything on its first robot, whatever that does to the robot; a task without one has no place."""
    robots = [place for place in view.robots if place not in view.denied]
    if not robots:
        return _keep_or_unplace(view, Reason.NO_CANDIDATE)
    if view.incumbent == robots[0]:
        return Choice(verdict=Verdict.KEPT, reason=Reason.ONBOARD_LOCAL, place=robots[0])
    if view.incumbent is not None and brakes.frozen:
        return Choice(verdict=Verdict.KEPT, reason=Reason.MOVES_FROZEN, place=view.incumbent)
    return Choice(verdict=Verdict.PLACED, reason=Reason.ONBOARD_LOCAL, place=robots[0])


def _keep_or_unplace(view: CandidateSet, reason: Reason) -> Choice:
    """No candidate at all: a running task stays where it is, another is unplaced."""
    if view.incumbent is not None:
        return Choice(verdict=Verdict.KEPT, reason=Reason.NOTHING_FITS, place=view.incumbent)
    return Choice(verdict=Verdict.UNPLACED, reason=reason)


CHOICE_RULES: Mapping[PolicyName, Callable[[CandidateSet, MoveConstraints], Choice]] = {
    PolicyName.UTILITY: choose_by_utility,
    PolicyName.PAPER: choose_by_paper,
    PolicyName.STATIC: choose_static,
    PolicyName.LOCAL: choose_local,
}
