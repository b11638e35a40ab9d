# SPDX-License-Identifier: Apache-2.0
"""A decided plan as a packing: its tasks as items, with their shares of capacity by place."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field, replace
from functools import cache
from math import inf

from edgectl.dataclass import dataclass
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.task import Task
from edgectl.scheduler.candidates import list_allowed_places
from edgectl.scheduler.decided_plan import DecidedPlan, list_wanted
from edgectl.scheduler.latency import may_keep_deadline
from edgectl.scheduler.ledger import compute_demand_usage
from edgectl.scheduler.packing import Item, Packing, ShareColumns, Shares, ShareTable, combine_items
from edgectl.scheduler.placement_rules import OccupancyLimit
from edgectl.scheduler.scan import list_limiting_resources

# Up to so many edges the shares of a task are computed for all of them at once.
MAX_ROWS = 64
_HOST_COLUMNS = {resource.name: column for column, resource in enumerate(HOST_RESOURCES)}
_NO_HOST_SHARES = dict.fromkeys(_HOST_COLUMNS.values(), 0.0)

PlaceSorter = Callable[[Sequence[int]], tuple[int, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFrame:
    """Whatever the items of one plan have in common.

    ``links``: the column of the link to each robot. ``leaders``: by task that is put as one item with others,
    the name of that item. ``needed``: tasks that others need which this plan starts. ``lacking``: edges that
    have no capacity, or no link to one of the robots, by robots.
    """

    plan: DecidedPlan
    links: Mapping[str, int]
    leaders: Mapping[str, str]
    needed: Collection[str]
    sort_places: PlaceSorter
    lacking: dict[tuple[str, ...], frozenset[int]] = field(default_factory=dict)


def build_plan_frame(plan: DecidedPlan, leaders: Mapping[str, str]) -> PlanFrame:
    """The frame of ``plan``, with the tasks that ``leaders`` names put as one."""
    return PlanFrame(
        plan=plan,
        links={robot: len(HOST_RESOURCES) + index for index, robot in enumerate(plan.ledger.free_links)},
        leaders=leaders,
        needed={
            need.task
            for task in plan.order
            if task.needs and task.name in plan.placed and task.name not in plan.initial.running
            for need in task.needs
        },
        sort_places=_build_place_sorter(plan),
    )


def _build_place_sorter(plan: DecidedPlan) -> PlaceSorter:
    """Sorts places so that names are irrelevant as far as hosts differ: the emptiest first."""
    order = plan.context.fleet.order
    free = [plan.ledger.free[resource.name] for resource in HOST_RESOURCES]
    ranked = sorted(range(len(order)), key=lambda place: (*[-row[place] for row in free], order[place]))
    ranks = {place: rank for rank, place in enumerate(ranked)}

    @cache
    def sort_places(places: Sequence[int]) -> tuple[int, ...]:
        return tuple(sorted(places, key=ranks.__getitem__))

    return sort_places


def build_search(plan: DecidedPlan) -> tuple[Packing, dict[str, list[int]]]:
    """The packing of ``plan``, with items also for tasks without room; and the columns of each task's
    links.

    No item is held by another: all are free to go where their own rules allow.
    """
    frame = build_plan_frame(plan, {name: name for name in plan.context.placement_rules.units})
    packing = build_packing(frame)
    for task in list_wanted(plan):
        packing.items[task.name] = build_item(frame, task)
    links = {
        task.name: [frame.links[robot] for robot in task.robots if robot in frame.links]
        for task in plan.order
        if task.name in packing.items
    }
    return packing, links


def build_packing(frame: PlanFrame) -> Packing:
    """The tasks that have a place in the plan, as items at their places."""
    plan = frame.plan
    fleet, ledger = plan.context.fleet, plan.ledger
    rows = [
        list(row) for row in zip(*(ledger.free[resource.name] for resource in HOST_RESOURCES), strict=True)
    ]
    for edge, shares in enumerate(zip(*ledger.free_links.values(), strict=True)):
        rows[edge] += shares
    on: list[list[str]] = [[] for _ in fleet.places]
    parts: dict[str, list[Item]] = {}
    at: dict[str, int] = {}
    for task in plan.order:
        if task.name in plan.placed:
            name = frame.leaders.get(task.name, task.name)
            parts.setdefault(name, []).append(build_item(frame, task))
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


def build_item(frame: PlanFrame, task: Task) -> Item:
    """One task of the plan; one without a place as a task that waits for one."""
    plan, name = frame.plan, task.name
    rules, running = plan.context.placement_rules, plan.initial.running.get(name)
    place = plan.placed[name][0] if name in plan.placed else None
    runs = running is not None and running.place == place
    held = runs and _is_held_in_place(plan, task)
    mates = _list_located_mates(plan, task) if rules.units and name not in frame.leaders else ()
    places: Sequence[int] = _list_places(frame, task, place)
    if mates and place is None:
        places = [each for each in places if each == mates[0]]
    limits = rules.limits.get(name, ())
    return Item(
        name=name,
        tasks=(name,),
        places=places,
        shares=_build_share_table(frame, task, place, places),
        priority=task.priority,
        runs=runs,
        movable=task.hosts.pin is None and not held and not mates,
        evictable=not held and (place is None or name not in frame.needed),
        limits=tuple(_rename_others(limit, frame.leaders) for limit in limits) if limits else (),
    )


def _list_places(frame: PlanFrame, task: Task, place: int | None) -> tuple[int, ...]:
    """The places that may take ``task``, which has ``place`` in the plan, in the order of the search."""
    allowed = list_allowed_places(frame.plan.context, task, place)
    if task.hard_deadline:
        ledger = frame.plan.ledger
        allowed = [each for each in allowed if each == place or may_keep_deadline(ledger, task, each)]
    return frame.sort_places(allowed if isinstance(allowed, range) else tuple(allowed))


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


def _build_share_table(frame: PlanFrame, task: Task, here: int | None, places: Sequence[int]) -> ShareTable:
    """Load / Delta of ``task``, computed when it is first asked for: from the rows of the scan where they
    exist, as fleets of few hosts have them. ``here``: its place in the plan, where it is charged what the
    plan has charged.
    """
    edges = frame.plan.context.fleet.edges
    exact = None if here is None else _measure_shares(frame, task, here)
    rows: ShareColumns | None = None

    def get_rows() -> ShareColumns:
        nonlocal rows
        if rows is None:
            rows = _list_share_rows(frame, task, here, exact)
        return rows

    def measure(place: int) -> Shares:
        if exact is not None and place == here:
            return exact
        known = get_rows() if place < edges else ()
        if not known or place in _find_lacking_edges(frame, task):
            return _measure_shares(frame, task, place)
        return _NO_HOST_SHARES | {column: row[place] for column, row in known}

    def list_columns() -> ShareColumns | None:
        on_edges = max(places, default=0) < edges and (here is None or here < edges)
        return (get_rows() or None) if on_edges else None

    return ShareTable(measure, list_columns)


def _list_share_rows(frame: PlanFrame, task: Task, here: int | None, exact: Shares | None) -> ShareColumns:
    """Load / Delta of ``task`` at every edge, of each column in which it may lack anything: a resource that
    limits no place, and of which the task demands nothing, is free everywhere. ``exact``: at its place.

    Empty where the fleet has many edges, or the task links that its robots do not say.
    """
    fleet, shares = frame.plan.context.fleet, frame.plan.context.shares
    floor = fleet.floors.get(task.name)
    links = {*task.robots, *(floor.links if floor is not None else ())}
    if fleet.edges > MAX_ROWS or len(links) > len(task.robots) or not links <= frame.links.keys():
        return ()
    names = list_limiting_resources(fleet, task)
    found = [(_HOST_COLUMNS[name], list(shares.of_host(task, name))) for name in names]
    found += [(frame.links[robot], list(shares.of_link(task, robot))) for robot in task.robots]
    for edge in _find_lacking_edges(frame, task):
        for _, row in found:
            row[edge] = inf
    if exact is not None and here is not None and here < fleet.edges:
        for column, row in found:
            row[here] = exact[column]
    return found


def _find_lacking_edges(frame: PlanFrame, task: Task) -> frozenset[int]:
    """Edges without capacity of some resource, or without a link to a robot of ``task``."""
    found = frame.lacking.get(task.robots)
    if found is None:
        fleet = frame.plan.context.fleet
        capacities = [*fleet.usable.values(), *(fleet.links[robot] for robot in task.robots)]
        lacking = (edge for edge in range(fleet.edges) if not all(row[edge] for row in capacities))
        found = frame.lacking[task.robots] = frozenset(lacking)
    return found


def _measure_shares(frame: PlanFrame, task: Task, place: int) -> Shares:
    """Load / Delta of ``task`` at ``place``.

    Without capacity or link infinite, but 0 where the task is: nothing is released by its leaving.
    """
    plan, fleet = frame.plan, frame.plan.context.fleet
    placed = plan.placed.get(task.name)
    is_there = placed is not None and placed[0] == place
    use = placed[1] if placed is not None and is_there else compute_demand_usage(fleet, task, place)
    none = 0.0 if is_there else inf
    shares = {
        column: _compute_share(amount, fleet.usable[name][place], none) if amount or not is_there else 0.0
        for column, (name, amount) in enumerate(use.used.items())
    }
    if place < fleet.edges:
        for robot in (*task.robots, *use.links):
            capacity = fleet.links[robot][place] if robot in fleet.links else None
            column = frame.links.get(robot, -1)
            shares[column] = _compute_share(use.links.get(robot, 0.0), capacity or 0.0, none)
    return shares


def _compute_share(amount: float, capacity: float, none: float) -> float:
    """``none``: the share of no capacity."""
    if capacity == inf:
        return 0.0
    return amount / capacity if capacity > 0 else none
