# SPDX-License-Identifier: Apache-2.0
"""Places of the inactive copies of tasks (ADR 0111). Pure.

They are placed once all tasks are, and change no place of a task. The rank of a host is its total (eq. (4))
for the whole demand of the task at the loads after the plan, without any copy; room is asked for what a copy
itself needs. So what one copy takes changes the rank of no host for another.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import NamedTuple

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Decision, RejectionRule, Verdict
from edgectl.model.demand import ZERO
from edgectl.model.policy import Policy
from edgectl.model.resource import HOST_RESOURCES, RESOURCES_BY_NAME
from edgectl.model.snapshot import TaskSample
from edgectl.model.standby import StandbyRule
from edgectl.model.standby_plan import StandbyReason
from edgectl.model.task import Task
from edgectl.rules.measured_demand import WARM_UP_S
from edgectl.scheduler.activation import is_usable
from edgectl.scheduler.candidates import (
    NEW_WORK_ONLY,
    CandidateSet,
    find_excess,
    gather_candidates,
    terms_at,
    weigh_candidates,
)
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.demand import demand_at
from edgectl.scheduler.evidence import FoundInstance
from edgectl.scheduler.ledger import Ledger, compute_free_share
from edgectl.scheduler.pass_state import PassResult, PlacementPass
from edgectl.scheduler.placement_rules import bar_by_limits
from edgectl.scheduler.scan import is_feasible_total
from edgectl.scheduler.task_usage import TaskUsage
from edgectl.scheduler.utility import EPSILON

# Rounds until no copy would be put elsewhere; of more than a few, the last one counts.
MAX_ROUNDS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class RankedPlace:
    """A place for a copy. ``fits``: it has room for the whole task, which a failover needs."""

    place: int
    total: float
    fits: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class StandbyCase:
    """One task and its copies.

    ``home``: the place of the task after the plan; None: it has none, and keeps no copy. ``left``: the place
    that a move leaves, whose instance can stay as a copy. ``present``: the places of the living copies, with
    the age (s) of each; ``held``: all of them stay, and no other is started. ``floor``: usage by resource
    below which the demand of a copy does not count. ``ranked``: the places that a copy may be at, best first;
    ``failed``: those where one has ended by itself.
    """

    task: Task
    rule: StandbyRule
    home: int | None
    left: int | None
    present: Mapping[int, float]
    held: bool
    floor: Mapping[str, float]
    ranked: tuple[RankedPlace, ...] = ()
    failed: frozenset[int] = frozenset()


class Staying(NamedTuple):
    """Why a copy stays although ``other`` leads it by ``lead``."""

    reason: StandbyReason
    other: int
    lead: float


@dataclass(slots=True, kw_only=True)
class StandbyPlaces:
    """The ``places`` of the copies of one task, best first; ``staying``: those that another host leads."""

    case: StandbyCase
    places: tuple[int, ...] = ()
    staying: dict[int, Staying] = field(default_factory=dict)


def place_standbys(how: PlacementPass, outcome: PassResult) -> tuple[list[StandbyPlaces], Ledger]:
    """The places of all copies, in sequence order of their tasks, and gamma with what is reserved for them.

    Repeated until nothing changes, so that a plan made right after its apply finds no better place either.
    """
    if not any(task.standby is not None for task in how.order):
        return [], outcome.ledger
    base = outcome.ledger.copy()
    found = [
        StandbyPlaces(case=case, places=_list_first_places(case)) for case in _list_cases(how, outcome, base)
    ]
    ledger = base
    for _ in range(MAX_ROUNDS):
        before = [each.places for each in found]
        ledger = _place_once(how, base, found)
        if [each.places for each in found] == before:
            break
    return found, ledger


def compute_standby_usage(fleet: Capacities, case: StandbyCase, place: int) -> TaskUsage:
    """What a copy counts for at ``place``: its demand, or what copies of it were measured to use if that is
    more.

    Memory that is not stated is that of the task: an instance that only waits has loaded what it needs.
    """
    used = {}
    for resource in HOST_RESOURCES:
        stated = case.rule.demand[resource.name]
        if stated is None and not resource.compressible and not resource.optional:
            stated = demand_at(fleet, case.task, place)[resource.name]
        amount = (stated or ZERO).of(fleet.raw[resource.name][place])
        used[resource.name] = max(amount, case.floor.get(resource.name, 0.0))
    return TaskUsage(used=used)


def has_room(ledger: Ledger, place: int, use: TaskUsage, *, spare: bool = False) -> bool:
    """Whether ``place`` holds a copy besides its load; ``spare``: and the slack besides, so that noise does
    not stop a copy that has just been started.

    Only what a copy needs is asked for: a full processor does not matter to one that waits.
    """
    fleet = ledger.fleet
    return all(
        compute_free_share(fleet.usable[name][place], ledger.used[name][place] + amount)
        >= (fleet.get_slack(RESOURCES_BY_NAME[name], place) if spare else 0.0) - EPSILON
        for name, amount in use.used.items()
        if amount > 0
    )


def _list_cases(how: PlacementPass, outcome: PassResult, base: Ledger) -> Iterator[StandbyCase]:
    decisions = {each.task: each for each in outcome.decisions}
    for task in how.order if how.rules.settles else ():
        if task.standby is not None:
            case = _build_case(how, outcome, task, task.standby, decisions[task.name])
            known = case.home is not None and not case.held
            yield replace(case, ranked=tuple(_rank_places(how, outcome, case, base))) if known else case


def _build_case(
    how: PlacementPass, outcome: PassResult, task: Task, rule: StandbyRule, decision: Decision
) -> StandbyCase:
    seen = how.initial.standbys.get(task.name, ())
    alive = [each for each in seen if each.sample.state.alive]
    held = decision.verdict is Verdict.HELD
    placed = outcome.placed.get(task.name)
    running = how.initial.running.get(task.name)
    moved = running is not None and placed is not None and running.place != placed[0]
    return StandbyCase(
        task=task,
        rule=rule,
        home=placed[0] if placed is not None else None,
        left=running.place if running is not None and moved and is_usable(running.sample, task) else None,
        present={each.place: how.context.now - each.sample.started_at for each in alive},
        held=held,
        floor=_measure_floor(how, alive),
        failed=frozenset(each.place for each in seen if _has_failed(each.sample, task)),
    )


def _has_failed(sample: TaskSample, task: Task) -> bool:
    """Whether a copy ended by itself: the same would only happen again (ADR 0022)."""
    return not sample.state.alive and sample.given_up and sample.spec_hash in ("", task.spec_hash)


def _measure_floor(how: PlacementPass, alive: Sequence[FoundInstance]) -> dict[str, float]:
    """The greatest use of a copy; of what it can go without, of those that have run long enough for it to be
    typical.
    """
    typical = [each for each in alive if how.context.now - each.sample.started_at >= WARM_UP_S]
    return {
        resource.name: max(each.sample.used[resource.name] for each in counted)
        for resource in HOST_RESOURCES
        if not resource.optional and (counted := typical if resource.compressible else alive)
    }


def _rank_places(
    how: PlacementPass, outcome: PassResult, case: StandbyCase, base: Ledger
) -> list[RankedPlace]:
    """The places that the rules of the task allow, by total for its whole demand."""
    weigh = _prepare_weighing(how, outcome, case, base)
    candidates = weigh(None)
    ranked = []
    for place in candidates.listed:
        if place == case.home or place in case.failed:
            continue
        known, denied = candidates, candidates.denied.get(place)
        if denied is not None and place in case.present and denied.rule in NEW_WORK_ONLY:
            known = weigh(place)  # what stands there may stay
        found = _rank_place(known, place, stays=place in case.present)
        if found is not None:
            ranked.append(found)
    order = how.context.fleet.order
    return sorted(ranked, key=lambda each: (not each.fits, -each.total, order[each.place]))


def _prepare_weighing(
    how: PlacementPass, outcome: PassResult, case: StandbyCase, base: Ledger
) -> Callable[[int | None], CandidateSet]:
    """Weighs the places for the task at the loads after the plan, for a copy that may stay at one of them."""
    name = case.task.name
    gone = {other for other, choice in outcome.choices.items() if choice.place is None}
    located = {other: place for other, place in how.initial.located.items() if other not in gone}
    located |= {other: place for other, (place, _) in outcome.placed.items()}
    limits = how.context.placement_rules.limits.get(name, ())
    barred = bar_by_limits(limits, name, located) if limits else None

    def weigh(incumbent: int | None) -> CandidateSet:
        return weigh_candidates(
            gather_candidates(
                how.context,
                base,
                case.task,
                incumbent=incumbent,
                predecessors={
                    need.task: located[need.task] for need in case.task.needs if need.task in located
                },
                placed={},
                barred=barred,
            )
        )

    return weigh


def _rank_place(candidates: CandidateSet, place: int, *, stays: bool) -> RankedPlace | None:
    """``place`` with its total; None where the task may not run there, whatever the room.

    ``stays``: a host where a copy stands counts as having room within the slack.
    """
    if place in candidates.denied:
        return None
    if is_feasible_total(candidates.totals[place]):
        return RankedPlace(place=place, total=candidates.totals[place], fits=True)
    _, total, rejections = terms_at(candidates, place)
    if total is None or any(each.rule is not RejectionRule.INSUFFICIENT for each in rejections):
        return None
    return RankedPlace(place=place, total=total, fits=stays and not find_excess(candidates, place))


def _list_first_places(case: StandbyCase) -> tuple[int, ...]:
    """Where copies may stay, best first; the instance that a move leaves is one of them."""
    if case.held:
        return tuple(case.present)
    there = {*case.present, case.left}
    return tuple(each.place for each in case.ranked if each.place in there)


def _place_once(how: PlacementPass, base: Ledger, found: Sequence[StandbyPlaces]) -> Ledger:
    """Give every task its copies once: those that stand keep their room, then others are added."""
    ledger = base.copy()
    for each in found:
        kept: list[int] = []
        for place in each.places:
            use = compute_standby_usage(ledger.fleet, each.case, place)
            if each.case.held or (len(kept) < each.case.rule.hosts and has_room(ledger, place, use)):
                ledger.charge(place, use)
                kept.append(place)
        each.places = tuple(kept)
    for each in found:
        if not (how.initial.frozen or each.case.held):
            _improve_places(how, ledger, each)
    return ledger


def _improve_places(how: PlacementPass, ledger: Ledger, found: StandbyPlaces) -> None:
    """Add the copies that are missing, and put those elsewhere for which another host is clearly better."""
    case, chosen = found.case, {place: position for position, place in enumerate(found.places)}
    rank = {each.place: each for each in case.ranked}
    for other in case.ranked:
        use = compute_standby_usage(ledger.fleet, case, other.place)
        if other.place in chosen or not has_room(ledger, other.place, use, spare=other.place != case.left):
            continue
        if len(chosen) >= case.rule.hosts:
            worst = max(chosen, key=lambda place: (not rank[place].fits, -rank[place].total, chosen[place]))
            staying = _find_reason_to_stay(how.context.policy, case, rank[worst], other)
            if staying is not None:
                found.staying[worst] = staying
                break
            ledger.release(worst, compute_standby_usage(ledger.fleet, case, worst))
            del chosen[worst]
        ledger.charge(other.place, use)
        chosen[other.place] = len(chosen)
    found.places = tuple(each.place for each in case.ranked if each.place in chosen)


def _find_reason_to_stay(
    policy: Policy, case: StandbyCase, here: RankedPlace, other: RankedPlace
) -> Staying | None:
    """None: a copy leaves ``here`` for ``other``, which has room for the whole task as ``here`` has not, or
    leads by more than the margin; and its dwell has passed.
    """
    lead = other.total - here.total
    gains = other.fits > here.fits or (other.fits == here.fits and lead > policy.move_margin + EPSILON)
    age = case.present.get(here.place)
    if gains and (age is None or age >= policy.min_dwell):
        return None
    if gains:
        return Staying(StandbyReason.DWELL, other.place, lead)
    reason = StandbyReason.BELOW_MARGIN if lead > EPSILON else StandbyReason.STILL_BEST
    return Staying(reason, other.place, lead)
