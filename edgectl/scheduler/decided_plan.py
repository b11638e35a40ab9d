# SPDX-License-Identifier: Apache-2.0
"""A decided plan as a packing: the view that its repair, its rebalancing and its optimum start from."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import inf

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Reason, Verdict
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.task import Task
from edgectl.scheduler.candidates import AssignmentContext, list_allowed_places
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.initial_state import InitialState
from edgectl.scheduler.latency import may_keep_deadline
from edgectl.scheduler.ledger import Ledger, compute_demand_usage
from edgectl.scheduler.packing import Item, Packing, Shares, ShareTable, combine_items
from edgectl.scheduler.placement_rules import OccupancyLimit
from edgectl.scheduler.rebalance import rebalance_packing
from edgectl.scheduler.sequence import is_need_met
from edgectl.scheduler.task_usage import TaskUsage
from edgectl.scheduler.utility_sum import Objective

# Up to so many edges the shares of a task are computed for all of them at once.
MAX_ROWS = 64

PlaceSorter = Callable[[tuple[int, ...]], tuple[int, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecidedPlan:
    """What the passes of a plan have decided, as far as a change of it needs that.

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


def build_search(plan: DecidedPlan) -> tuple[Packing, dict[str, list[int]]]:
    """The packing of ``plan``, with items also for tasks without room; and the columns of each task's
    links.

    No item is held by another: all are free to go where their own rules allow.
    """
    columns, sort_places = list_link_columns(plan), build_place_sorter(plan)
    alone = {name: name for name in plan.context.placement_rules.units}
    packing = build_packing(plan, sort_places, alone)
    for task in list_wanted(plan):
        packing.items[task.name] = build_item(plan, columns, task, sort_places, alone)
    links = {
        task.name: [columns[robot] for robot in task.robots if robot in columns]
        for task in plan.order
        if task.name in packing.items
    }
    return packing, links


def build_packing(plan: DecidedPlan, sort_places: PlaceSorter, leaders: Mapping[str, str]) -> Packing:
    """``leaders``: the names of the items of tasks that are put as one."""
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
    columns = list_link_columns(plan)
    parts: dict[str, list[Item]] = {}
    at: dict[str, int] = {}
    for task in plan.order:
        if task.name in plan.placed:
            name = leaders.get(task.name, task.name)
            parts.setdefault(name, []).append(build_item(plan, columns, task, sort_places, leaders, needed))
            at[name] = plan.placed[task.name][0]
    items = {name: combine_items(name, part) for name, part in parts.items()}
    for name, place in at.items():
        on[place].append(name)
    return Packing(
        free=rows,
        items=items,
        at=at,
        home=dict(at),
        on=on,
        work=0,
        moves_left=plan.moves_left,
        fixed={name: place for name, place in plan.initial.located.items() if name not in plan.choices}
        if plan.context.placement_rules.limits
        else {},
    )


def build_place_sorter(plan: DecidedPlan) -> PlaceSorter:
    """Sorts places so that names are irrelevant as far as hosts differ: the emptiest first."""
    order = plan.context.fleet.order
    free = [plan.ledger.free[resource.name] for resource in HOST_RESOURCES]
    ranked = sorted(range(len(order)), key=lambda place: (*[-row[place] for row in free], order[place]))
    ranks = {place: rank for rank, place in enumerate(ranked)}

    @cache
    def sort_places(places: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(sorted(places, key=ranks.__getitem__))

    return sort_places


def build_item(
    plan: DecidedPlan,
    columns: Mapping[str, int],
    task: Task,
    sort_places: PlaceSorter,
    leaders: Mapping[str, str],
    needed: Collection[str] = (),
) -> Item:
    """``columns``: of the link to each robot; ``needed``: tasks that others need which this plan starts."""
    running = plan.initial.running.get(task.name)
    place = plan.placed[task.name][0] if task.name in plan.placed else None
    runs = running is not None and running.place == place
    held = runs and _is_held_in_place(plan, task)
    mates = _list_located_mates(plan, task) if task.name not in leaders else []
    allowed = list_allowed_places(plan.context, task, place)
    if task.hard_deadline:
        allowed = [each for each in allowed if each == place or may_keep_deadline(plan.ledger, task, each)]
    places = sort_places(tuple(allowed))
    return Item(
        name=task.name,
        tasks=(task.name,),
        places=places if not mates or place is not None else [each for each in places if each == mates[0]],
        shares=_build_share_table(plan, columns, task),
        priority=task.priority,
        runs=runs,
        movable=task.hosts.pin is None and not held and not mates,
        evictable=not held and task.name not in needed,
        limits=tuple(
            _rename_others(limit, leaders) for limit in plan.context.placement_rules.limits.get(task.name, ())
        ),
    )


def _list_located_mates(plan: DecidedPlan, task: Task) -> list[int]:
    """The places of other tasks of the unit of ``task``."""
    return [
        plan.placed[mate][0] if mate in plan.placed else plan.initial.located[mate]
        for mate in plan.context.placement_rules.units.get(task.name, ())
        if mate != task.name
        and (mate in plan.placed or (mate in plan.initial.located and mate not in plan.choices))
    ]


def _rename_others(limit: OccupancyLimit, leaders: Mapping[str, str]) -> OccupancyLimit:
    """``limit`` with the names of items instead of those of tasks."""
    if not leaders:
        return limit
    return replace(limit, others=frozenset(leaders.get(name, name) for name in limit.others))


def _is_held_in_place(plan: DecidedPlan, task: Task) -> bool:
    """Whether a running task must stay: the fleet is frozen, or its dwell time has not passed."""
    since = plan.initial.running[task.name].since
    dwelling = since is not None and plan.context.now - since < plan.context.policy.min_dwell
    return plan.initial.frozen or dwelling


def list_link_columns(plan: DecidedPlan) -> dict[str, int]:
    """The column of the link to each robot."""
    return {robot: len(HOST_RESOURCES) + index for index, robot in enumerate(plan.ledger.free_links)}


def _build_share_table(plan: DecidedPlan, columns: Mapping[str, int], task: Task) -> ShareTable:
    """Load / Delta of ``task`` by place, each computed once: from the rows of the scan where they exist, as
    fleets of few hosts have them.
    """
    fleet = plan.context.fleet
    rows = _list_share_rows(plan, columns, task)
    capacities = [*fleet.usable.values(), *(fleet.links[robot] for robot in task.robots if rows)]
    complete = all(all(row[: fleet.edges]) for row in capacities)
    here = plan.placed[task.name][0] if task.name in plan.placed else None

    def measure(place: int) -> Shares:
        exact = not rows or place == here or place >= fleet.edges
        if exact or not (complete or all(row[place] for row in capacities)):
            return _measure_shares(plan, columns, task, place)
        return {column: row[place] for column, row in rows.items()}

    return ShareTable(measure)


def _list_share_rows(plan: DecidedPlan, columns: Mapping[str, int], task: Task) -> dict[int, Sequence[float]]:
    """Load / Delta of ``task`` at every edge, by column; empty where the fleet has many edges, or the task
    links that its robots do not say.
    """
    fleet, shares = plan.context.fleet, plan.context.shares
    floor = fleet.floors.get(task.name)
    links = {*task.robots, *(floor.links if floor is not None else ())}
    if fleet.edges > MAX_ROWS or len(links) > len(task.robots) or not links <= columns.keys():
        return {}
    hosts = {column: shares.of_host(task, each.name) for column, each in enumerate(HOST_RESOURCES)}
    return {**hosts, **{columns[robot]: shares.of_link(task, robot) for robot in task.robots}}


def _measure_shares(plan: DecidedPlan, columns: Mapping[str, int], task: Task, place: int) -> Shares:
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


def list_wanted(plan: DecidedPlan) -> list[Task]:
    """Tasks without room, and those that only wait for them, in sequence order."""
    reach = find_located(plan)
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


def find_located(plan: DecidedPlan) -> set[str]:
    """Tasks that count as predecessors; one that ran and lost its place does not."""
    homeless = {name for name, choice in plan.choices.items() if choice.place is None}
    return (set(plan.initial.located) - homeless) | plan.placed.keys()


def rate_plan(plan: DecidedPlan) -> float:
    """The sum of the utilities of all placed tasks at the loads after the plan."""
    packing = build_packing(plan, build_place_sorter(plan), {})
    return _build_objective(plan).rate(packing, packing.at)


def _build_objective(plan: DecidedPlan) -> Objective:
    columns = list_link_columns(plan)
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


def rebalance_plan(plan: DecidedPlan, *, started_only: bool = False) -> dict[str, Choice]:
    """The choices with which the sum of all utilities is higher (ADR 66), where they differ from those of
    ``plan``.

    ``started_only``: no running task moves.
    """
    packing = build_packing(plan, build_place_sorter(plan), {})
    if started_only:
        for name in packing.items.keys() & plan.initial.running.keys():
            packing.items[name] = replace(packing.items[name], movable=False)
    rebalance_packing(packing, _build_objective(plan), plan.context.policy.move_margin)
    return {
        name: replace(choice, reason=Reason.REBALANCED, subject=None)
        for name, choice in build_choices(plan, packing, {}).items()
    }


def choose_places(plan: DecidedPlan, places: Mapping[str, int]) -> dict[str, Choice]:
    """The choices that give each task its place of ``places``, or none, where they differ from ``plan``."""
    changed = {
        name: Choice(
            verdict=Verdict.PLACED, reason=Reason.OPTIMAL, place=place, voluntary=name in plan.initial.running
        )
        for name, place in places.items()
        if name not in plan.placed or plan.placed[name][0] != place
    }
    gone = plan.placed.keys() - places.keys()
    return changed | {
        name: Choice(verdict=Verdict.UNPLACED, reason=Reason.NO_FEASIBLE_HOST) for name in sorted(gone)
    }


def build_choices(plan: DecidedPlan, packing: Packing, causes: Mapping[str, str]) -> dict[str, Choice]:
    """The choices of ``packing`` where they differ from those of ``plan``. ``causes``: by item, the task that
    it was moved for.
    """
    items = {task: item.name for item in packing.items.values() for task in item.tasks}
    changed = {
        name: Choice(verdict=Verdict.UNPLACED, reason=Reason.PREEMPTED, subject=causes.get(items[name]))
        for name in plan.placed
        if items[name] not in packing.at
    }
    for item, place in packing.at.items():
        for name in packing.items[item].tasks:
            choice = _build_choice(plan, name, place, causes.get(item))
            if choice is not None:
                changed[name] = choice
    return changed


def _build_choice(plan: DecidedPlan, name: str, place: int, cause: str | None) -> Choice | None:
    """The choice of ``place`` for task ``name``; None where it has it already."""
    if name not in plan.placed:
        return Choice(verdict=Verdict.PLACED, reason=Reason.ROOM_MADE, place=place)
    if plan.placed[name][0] == place:
        return None
    return Choice(
        verdict=Verdict.PLACED,
        reason=Reason.MADE_ROOM,
        place=place,
        subject=cause,
        voluntary=name in plan.initial.running,
    )
