# SPDX-License-Identifier: Apache-2.0
"""Steps of a plan for the inactive copies of tasks, from their places. Pure."""

from collections.abc import Iterator, Sequence

from edgectl.model.resource import Usage
from edgectl.model.standby_plan import StandbyAction, StandbyReason, StandbyStep
from edgectl.scheduler.activation import is_usable
from edgectl.scheduler.evidence import FoundInstance
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.pass_state import PlacementPass
from edgectl.scheduler.standbys import (
    StandbyCase,
    StandbyPlaces,
    compute_standby_usage,
    has_room,
)


def build_standby_steps(
    how: PlacementPass, found: Sequence[StandbyPlaces], ledger: Ledger
) -> dict[str, tuple[StandbyStep, ...]]:
    """What becomes of the copies of each task that has or wants some, those that stop first.

    ``ledger``: gamma with what is reserved for all of them.
    """
    wanted = {each.case.task.name: each for each in found}
    steps = {}
    for task in how.order:
        seen = how.initial.standbys.get(task.name, ()) if task.managed else ()
        places = wanted.get(task.name)
        made = (
            (*_list_changes(how, places, seen, ledger), *_list_missing(how, places))
            if places is not None
            else tuple(_stop(how, each, StandbyReason.NOT_WANTED) for each in seen if each.sample.state.alive)
        )
        if made:
            steps[task.name] = tuple(sorted(made, key=lambda step: step.action is not StandbyAction.STOP))
    return steps


def _list_changes(
    how: PlacementPass, found: StandbyPlaces, seen: Sequence[FoundInstance], ledger: Ledger
) -> Iterator[StandbyStep]:
    alive = {each.place: each for each in seen if each.sample.state.alive}
    for place, each in alive.items():
        if place not in found.places:
            yield _end_copy(how, found, each, ledger)
    for place in found.places:
        yield _keep_copy(how, found, place, alive.get(place), ledger)


def _end_copy(how: PlacementPass, found: StandbyPlaces, copy: FoundInstance, ledger: Ledger) -> StandbyStep:
    """A copy that is none after the plan: it becomes the task, or stops."""
    case, place = found.case, copy.place
    if place == case.home:
        if is_usable(copy.sample, case.task):
            name = how.context.fleet.places[place].name
            return StandbyStep(
                host=name,
                action=StandbyAction.ACTIVATE,
                reason=StandbyReason.TASK_HERE,
                instance=copy.sample.instance,
            )
        return _stop(how, copy, StandbyReason.TASK_HERE)
    if case.home is None:
        return _stop(how, copy, StandbyReason.NOT_PLACED)
    if all(each.place != place for each in case.ranked):
        return _stop(how, copy, StandbyReason.EXCLUDED)
    if not has_room(ledger, place, compute_standby_usage(ledger.fleet, case, place)):
        return _stop(how, copy, StandbyReason.NO_ROOM)
    return _stop(how, copy, StandbyReason.OUTRANKED, found.places[0] if found.places else None)


def _stop(
    how: PlacementPass, copy: FoundInstance, reason: StandbyReason, subject: int | None = None
) -> StandbyStep:
    places = how.context.fleet.places
    return StandbyStep(
        host=places[copy.place].name,
        action=StandbyAction.STOP,
        reason=reason,
        instance=copy.sample.instance,
        subject=None if subject is None else places[subject].name,
    )


def _keep_copy(
    how: PlacementPass, found: StandbyPlaces, place: int, copy: FoundInstance | None, ledger: Ledger
) -> StandbyStep:
    """A copy that stands at ``place`` after the plan."""
    places, case, staying = how.context.fleet.places, found.case, found.staying.get(place)
    action, reason, instance = _choose_action(how, case, place, copy)
    if staying is not None and reason is StandbyReason.STILL_BEST:
        reason = staying.reason
    else:
        staying = None
    totals = {each.place: each.total for each in case.ranked}
    return StandbyStep(
        host=places[place].name,
        action=action,
        reason=reason,
        instance=instance,
        subject=None if staying is None else places[staying.other].name,
        amount=None if staying is None else _get_amount(how, case, place, staying.lead, reason),
        total=totals.get(place),
        demand=Usage(compute_standby_usage(ledger.fleet, case, place).used),
    )


def _get_amount(
    how: PlacementPass, case: StandbyCase, place: int, lead: float, reason: StandbyReason
) -> float:
    """The seconds of dwell that are left, or the lead of the other host."""
    if reason is StandbyReason.DWELL:
        return how.context.policy.min_dwell - case.present[place]
    return lead


def _choose_action(
    how: PlacementPass, case: StandbyCase, place: int, copy: FoundInstance | None
) -> tuple[StandbyAction, StandbyReason, str]:
    """Action, reason and instance of a copy that stands at ``place`` after the plan."""
    if copy is None:
        running = how.initial.running.get(case.task.name)
        if place == case.left and running is not None and running.sample is not None:
            return StandbyAction.DEACTIVATE, StandbyReason.RUNNER_UP, running.sample.instance
        return StandbyAction.START, StandbyReason.RUNNER_UP, ""
    instance = copy.sample.instance
    if case.held:
        return StandbyAction.KEEP, StandbyReason.HELD, instance
    if is_usable(copy.sample, case.task):
        return StandbyAction.KEEP, StandbyReason.STILL_BEST, instance
    reason = StandbyReason.ORPHANED if copy.sample.orphaned else StandbyReason.SPEC_CHANGED
    return StandbyAction.RESTART, reason, instance


def _list_missing(how: PlacementPass, found: StandbyPlaces) -> Iterator[StandbyStep]:
    """Where a copy has failed, and why there are fewer than the task asks for."""
    case, places = found.case, how.context.fleet.places
    for place in sorted(case.failed, key=how.context.fleet.order.__getitem__):
        yield StandbyStep(host=places[place].name, action=StandbyAction.NONE, reason=StandbyReason.FAILED)
    if case.held or case.home is None or len(found.places) >= case.rule.hosts:
        return
    left = [each.place for each in case.ranked if each.place not in found.places]
    if how.initial.frozen:
        reason = StandbyReason.MOVES_FROZEN
    else:
        reason = StandbyReason.NO_ROOM if left else StandbyReason.NO_HOST
    subject = places[left[0]].name if left and reason is StandbyReason.NO_ROOM else None
    yield StandbyStep(host=None, action=StandbyAction.NONE, reason=reason, subject=subject)
