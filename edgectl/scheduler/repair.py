"""Repair of a plan that leaves tasks unplaced for lack of room: others make room for them (ADR 64).

The same view of a plan serves its rebalancing (ADR 66).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf

from edgectl.model.assignment import Reason, Verdict
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.task import Task
from edgectl.scheduler.candidates import AssignmentContext, list_allowed_places
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.initial_state import InitialState
from edgectl.scheduler.ledger import Ledger, compute_demand_usage
from edgectl.scheduler.packing import Item, Packing, Shares, place_item, preempt_for_item, restore_homes
from edgectl.scheduler.rebalance import Objective, rebalance_packing
from edgectl.scheduler.sequence import is_need_met
from edgectl.scheduler.task_usage import TaskUsage
from edgectl.scheduler.utility import EPSILON

# Looks at one task at one place: some 0.2 s for a whole plan, and at least this many for each task.
MAX_WORK, MIN_WORK = 300_000, 4_000


@dataclass(frozen=True, slots=True, kw_only=True)
class UnrepairedPlan:
    """What a plan has decided, as far as the repair needs it.

    ``placed``: place and demand of each task that has one. ``ledger``: gamma afterwards. ``moves_left``:
    moves of running tasks that are still allowed; None: any number.
    """

    context: AssignmentContext
    order: Sequence[Task]
    initial: InitialState
    choices: Mapping[str, Choice]
    placed: Mapping[str, tuple[int, TaskUsage]]
    ledger: Ledger
    moves_left: int | None = None


def repair_plan(plan: UnrepairedPlan) -> dict[str, Choice]:
    """The choices that differ from those of ``plan``: tasks that find room now, and tasks that made it.

    Every task that has a place keeps one. Empty where nothing is unplaced for lack of room, or no way is
    found.
    """
    wanted = _list_wanted(plan)
    if not wanted:
        return {}
    packing, columns = _build_packing(plan), _list_link_columns(plan)
    work = MAX_WORK
    causes: dict[str, str] = {}
    bounded = _has_absolute_demands(plan)
    located = _find_located(plan)
    for task in wanted:
        if work <= 0 or not all(is_need_met(need, located, plan.initial.completed) for need in task.needs):
            continue
        packing.work = share = min(work, max(MIN_WORK, MAX_WORK // len(wanted)))
        before = dict(packing.at)
        item = _build_item(plan, columns, task)
        possible = not bounded or _has_room_in_sum(plan, packing, task)
        if (possible and place_item(packing, item)) or (task.preempt and preempt_for_item(packing, item)):
            located.add(task.name)
            causes |= {name: task.name for name, place in before.items() if packing.at.get(name) != place}
        work -= share - packing.work
    restore_homes(packing)
    return _build_choices(plan, packing, causes)


def rebalance_plan(plan: UnrepairedPlan) -> dict[str, Choice]:
    """The choices with which the sum of all utilities is higher (ADR 66), where they differ from those of
    ``plan``.
    """
    packing = _build_packing(plan)
    rebalance_packing(packing, _build_objective(plan), plan.context.policy.move_margin)
    return {
        name: replace(choice, reason=Reason.REBALANCED, subject=None)
        for name, choice in _build_choices(plan, packing, {}).items()
    }


def rate_plan(plan: UnrepairedPlan) -> float:
    """The sum of the utilities of all placed tasks at the loads after the plan."""
    packing = _build_packing(plan)
    return _build_objective(plan).rate(packing, packing.at)


def _build_objective(plan: UnrepairedPlan) -> Objective:
    columns = _list_link_columns(plan)
    placed = [task for task in plan.order if task.name in plan.placed]
    successors: dict[str, list[str]] = {task.name: [] for task in placed}
    for task in placed:
        for need in task.needs:
            successors.setdefault(need.task, []).append(task.name)
    return Objective(
        weights=plan.context.policy.weights,
        edges=plan.context.fleet.edges,
        links={task.name: [columns[robot] for robot in task.robots if robot in columns] for task in placed},
        needs={task.name: [need.task for need in task.needs] for task in placed},
        successors=successors,
        elsewhere=plan.initial.located,
    )


def _list_wanted(plan: UnrepairedPlan) -> list[Task]:
    """Tasks without room, and those that only wait for them, in sequence order."""
    reach = _find_located(plan)
    wanted = []
    for task in plan.order:
        choice = plan.choices.get(task.name)
        if choice is None or choice.verdict is not Verdict.UNPLACED:
            continue
        if choice.reason is Reason.NO_FEASIBLE_HOST or (
            choice.reason is Reason.PREDECESSOR_MISSING
            and all(is_need_met(need, reach, plan.initial.completed) for need in task.needs)
        ):
            reach.add(task.name)
            wanted.append(task)
    return wanted


def _find_located(plan: UnrepairedPlan) -> set[str]:
    """Tasks that count as predecessors; one that ran and lost its place does not."""
    homeless = {name for name, choice in plan.choices.items() if choice.place is None}
    return (set(plan.initial.located) - homeless) | plan.placed.keys()


def _has_absolute_demands(plan: UnrepairedPlan) -> bool:
    """Whether no demand depends on the place, so that what is free in sum stays free in sum."""
    return not plan.context.fleet.demands and not any(
        quantity is not None and quantity.relative for task in plan.order for quantity in task.demand.values()
    )


def _has_room_in_sum(plan: UnrepairedPlan, packing: Packing, task: Task) -> bool:
    """False where all that is free on all hosts together is too little: then nobody can make room."""
    fleet = plan.context.fleet
    demand = compute_demand_usage(fleet, task, 0).used
    for column, (name, amount) in enumerate(demand.items()):
        free = (max(0.0, row[column]) * fleet.usable[name][place] for place, row in enumerate(packing.free))
        if amount > sum(free) * (1 + EPSILON):
            return False
    return True


def _build_packing(plan: UnrepairedPlan) -> Packing:
    fleet, ledger = plan.context.fleet, plan.ledger
    rows = [
        list(row) for row in zip(*(ledger.free[resource.name] for resource in HOST_RESOURCES), strict=True)
    ]
    for edge, shares in enumerate(zip(*ledger.free_links.values(), strict=True)):
        rows[edge] += shares
    on: list[list[str]] = [[] for _ in fleet.places]
    needed = {
        need.task
        for task in plan.order
        if task.name in plan.placed and task.name not in plan.initial.running
        for need in task.needs
    }
    columns = _list_link_columns(plan)
    items = {
        task.name: _build_item(plan, columns, task, needed) for task in plan.order if task.name in plan.placed
    }
    at = {name: plan.placed[name][0] for name in items}
    for name, place in at.items():
        on[place].append(name)
    return Packing(free=rows, items=items, at=at, home=dict(at), on=on, work=0, moves_left=plan.moves_left)


def _build_item(
    plan: UnrepairedPlan, columns: Mapping[str, int], task: Task, needed: Collection[str] = ()
) -> Item:
    """``columns``: of the link to each robot; ``needed``: tasks that others need which this plan starts."""
    running = plan.initial.running.get(task.name)
    place = plan.placed[task.name][0] if task.name in plan.placed else None
    runs = running is not None and running.place == place
    held = runs and _is_held_in_place(plan, task)
    return Item(
        name=task.name,
        places=list_allowed_places(plan.context, task, place),
        measure=partial(_measure_shares, plan, columns, task),
        priority=task.priority,
        runs=runs,
        movable=task.hosts.pin is None and not held,
        evictable=not held and task.name not in needed,
    )


def _is_held_in_place(plan: UnrepairedPlan, task: Task) -> bool:
    """Whether a running task must stay: the fleet is frozen, or its dwell time has not passed."""
    since = plan.initial.running[task.name].since
    dwelling = since is not None and plan.context.now - since < plan.context.policy.min_dwell
    return plan.initial.frozen or dwelling


def _list_link_columns(plan: UnrepairedPlan) -> dict[str, int]:
    """The column of the link to each robot."""
    return {robot: len(HOST_RESOURCES) + index for index, robot in enumerate(plan.ledger.free_links)}


def _measure_shares(plan: UnrepairedPlan, columns: Mapping[str, int], task: Task, place: int) -> Shares:
    """Load / Delta of ``task`` at ``place``.

    Without capacity or link infinite, but 0 where the task is: nothing is released by its leaving.
    """
    fleet = plan.context.fleet
    placed = plan.placed.get(task.name)
    is_there = placed is not None and placed[0] == place
    use = placed[1] if placed is not None and is_there else compute_demand_usage(fleet, task, place)
    none = 0.0 if is_there else inf
    shares = {
        column: _compute_share(amount, fleet.usable[name][place], none)
        for column, (name, amount) in enumerate(use.used.items())
    }
    if place < fleet.edges:
        for robot in (*task.robots, *use.links):
            capacity = fleet.links[robot][place] if robot in fleet.links else None
            shares[columns.get(robot, -1)] = _compute_share(use.links.get(robot, 0.0), capacity or 0.0, none)
    return shares


def _compute_share(amount: float, capacity: float, none: float) -> float:
    """``none``: the share of no capacity."""
    if capacity == inf:
        return 0.0
    return amount / capacity if capacity > 0 else none


def _build_choices(plan: UnrepairedPlan, packing: Packing, causes: Mapping[str, str]) -> dict[str, Choice]:
    changed = {
        name: Choice(verdict=Verdict.UNPLACED, reason=Reason.PREEMPTED, subject=causes.get(name))
        for name in plan.placed
        if name not in packing.at
    }
    for name, place in packing.at.items():
        if name not in plan.placed:
            changed[name] = Choice(verdict=Verdict.PLACED, reason=Reason.ROOM_MADE, place=place)
        elif plan.placed[name][0] != place:
            changed[name] = Choice(
                verdict=Verdict.PLACED,
                reason=Reason.MADE_ROOM,
                place=place,
                subject=causes.get(name),
                voluntary=name in plan.initial.running,
            )
    return changed
