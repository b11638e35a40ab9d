# SPDX-License-Identifier: Apache-2.0
"""Repair of a plan that leaves tasks unplaced for lack of room: others make room for them (ADR 64)."""

from collections.abc import Collection, Mapping, Sequence

from edgectl.model.task import Task
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.decided_plan import (
    DecidedPlan,
    build_choices,
    build_place_choices,
    find_located,
    list_wanted,
)
from edgectl.scheduler.insertion import extend_item, place_item, preempt_for_item
from edgectl.scheduler.ledger import compute_demand_usage
from edgectl.scheduler.packed_plan import PlanFrame, build_item, build_packing, build_plan_frame
from edgectl.scheduler.packing import Item, Packing, combine_items, restore_homes
from edgectl.scheduler.quick_room import find_quick_room
from edgectl.scheduler.sequence import is_need_met
from edgectl.scheduler.utility import EPSILON

# Looks at one task at one place: some 0.2 s for a whole plan, and at least this many for each task.
MAX_WORK, MIN_WORK = 300_000, 4_000


def repair_plan(plan: DecidedPlan) -> dict[str, Choice]:
    """The choices that differ from those of ``plan``: tasks that find room now, and tasks that made it.

    Every task that has a place keeps one. Empty where nothing is unplaced for lack of room, or no way is
    found.
    """
    wanted = list_wanted(plan)
    if not wanted:
        return {}
    quick = find_quick_room(plan, wanted)
    if quick is not None:
        return build_place_choices(plan, quick.places, quick.causes)
    leaders = _choose_leaders(plan)
    frame = build_plan_frame(plan, leaders)
    packing = build_packing(frame)
    work = MAX_WORK
    causes: dict[str, str] = {}
    bounded = _has_absolute_demands(plan)
    located = find_located(plan)
    # Twice: a task that found no room may find it among the others as they are in the end.
    for index, task in enumerate([*wanted, *wanted]):
        joining = _list_joining(plan, task, wanted, located, leaders)
        if work <= 0 or not joining:
            continue
        packing.work = share = min(work, max(MIN_WORK, work // (len(wanted) - index % len(wanted))))
        before = dict(packing.at)
        possible = not bounded or all(_has_room_in_sum(plan, packing, each) for each in joining)
        item = _build_joint_item(frame, joining, packing)
        # Of one task only: what a search in vain has drawn decides how the next one goes.
        if len(wanted) == 1 and item.name not in packing.at:
            from edgectl.scheduler.dead_end import is_dead_end

            possible = possible and not is_dead_end(packing, item)
        if _place_joint_item(packing, item, possible=possible, preempt=any(each.preempt for each in joining)):
            located.update(each.name for each in joining)
            causes |= {name: task.name for name, place in before.items() if packing.at.get(name) != place}
        work -= share - packing.work
    restore_homes(packing)
    return build_choices(plan, packing, causes)


def _place_joint_item(packing: Packing, item: Item, *, possible: bool, preempt: bool) -> bool:
    if item.name in packing.at:
        return possible and extend_item(packing, item)
    return (possible and place_item(packing, item)) or (preempt and preempt_for_item(packing, item))


def _choose_leaders(plan: DecidedPlan) -> dict[str, str]:
    """By task of each unit that the search puts as one item, the name of that item.

    Not of a unit that is divided, or of which a task has a place that the plan does not decide.
    """
    leaders: dict[str, str] = {}
    for unit in set(plan.context.placement_rules.units.values()):
        places = {plan.placed[name][0] for name in unit if name in plan.placed}
        if len(places) <= 1 and all(name in plan.choices for name in unit if name in plan.initial.located):
            leaders |= dict.fromkeys(unit, unit[0])
    return leaders


def _list_joining(
    plan: DecidedPlan,
    task: Task,
    wanted: Sequence[Task],
    located: Collection[str],
    leaders: Mapping[str, str],
) -> list[Task]:
    """``task`` and the wanted tasks of its unit, where all that they need has a place; empty if it has not,
    or if ``task`` has got a place by now.
    """
    if task.name in located:
        return []
    leader = leaders.get(task.name)
    unit = [task] if leader is None else [each for each in wanted if leaders.get(each.name) == leader]
    reach = {*located, *(each.name for each in unit)}
    joining = [
        each for each in unit if all(is_need_met(need, reach, plan.initial.completed) for need in each.needs)
    ]
    return joining if task in joining and len(joining) == len(unit) else []


def _build_joint_item(frame: PlanFrame, joining: Sequence[Task], packing: Packing) -> Item:
    """One item of tasks that get a place together, and of what is in place of their unit."""
    items = [build_item(frame, task) for task in joining]
    name = frame.leaders.get(joining[0].name, joining[0].name)
    if name in packing.at:
        items.insert(0, packing.items[name])
    return combine_items(name, items)


def _has_absolute_demands(plan: DecidedPlan) -> bool:
    """Whether no demand depends on the place, so that what is free in sum stays free in sum."""
    return not plan.context.fleet.demands and not any(
        quantity is not None and quantity.relative for task in plan.order for quantity in task.demand.values()
    )


def _has_room_in_sum(plan: DecidedPlan, packing: Packing, task: Task) -> bool:
    """False where all that is free on all hosts together is too little: then nobody can make room."""
    fleet = plan.context.fleet
    demand = compute_demand_usage(fleet, task, 0).used
    for column, (name, amount) in enumerate(demand.items()):
        if amount:
            usable = fleet.usable[name]
            pairs = zip(packing.free, usable, strict=True)
            free = sum([row[column] * capacity for row, capacity in pairs if row[column] > 0.0])
            if amount > free * (1 + EPSILON):
                return False
    return True
