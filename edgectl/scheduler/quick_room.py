# SPDX-License-Identifier: Apache-2.0
"""A first search for room, in which two hosts share out their tasks anew (ADR 175). Pure and deterministic.

It settles most plans in a fraction of the time that ``insertion`` takes, and is all or nothing: every task
finds room, or nothing is changed. Only tasks that this plan starts make room, and only those whose demand is
the same on every host.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field
from itertools import combinations
from math import inf
from operator import itemgetter
from typing import NamedTuple

from edgectl.dataclass import dataclass
from edgectl.model.demand import ZERO
from edgectl.model.resource import CPU, HOST_RESOURCES, MEMORY, NETWORK
from edgectl.model.task import Task
from edgectl.scheduler.candidates import get_edge_rejections
from edgectl.scheduler.decided_plan import DecidedPlan
from edgectl.scheduler.pair_split import MAX_CHANGES, Range, find_changes
from edgectl.scheduler.placement_rules import NO_RULES
from edgectl.scheduler.utility import EPSILON

# Hosts that are looked at: the emptiest. Pairs of these that are shared out anew: for each task without a
# place, and the least and the most for all.
MAX_HOSTS = 128
PAIRS_PER_TASK, MIN_PAIRS, MAX_PAIRS = 40, 100, 1500
# Half of what rounding may take, so that sums in another order still fit.
_TOLERANCE = EPSILON / 2
_OPTIONAL = [resource.name for resource in HOST_RESOURCES if resource.optional]


class QuickRoom(NamedTuple):
    """The places of the tasks that have found room or made it, and the task for which each was moved."""

    places: Mapping[str, int]
    causes: Mapping[str, str]


class _Mover(NamedTuple):
    """A task that may be put elsewhere. ``rate``: bytes/s; ``size``: its shares of the whole fleet, added;
    ``denied``: edges that its rules forbid.
    """

    task: Task
    cpu: float
    memory: float
    rate: float
    size: float
    denied: Collection[int]


@dataclass(slots=True, kw_only=True)
class _Sharing:
    """``hosts``: the emptiest first; ``cpu`` and ``memory``: what is free, by place. ``on``: movers by place,
    ``at``: the place of each. ``carried``: bytes/s that have come to the link from a robot to a place.
    ``doubles``: each two hosts and their capacity; ``pairs``: of these, how many are still shared out.
    """

    plan: DecidedPlan
    hosts: Sequence[int]
    cpu: list[float]
    memory: list[float]
    movers: Mapping[str, _Mover]
    on: Sequence[dict[str, _Mover]]
    at: dict[str, int]
    doubles: Sequence[tuple[int, int, float, float]]
    pairs: int
    carried: dict[tuple[str, int], float] = field(default_factory=dict)


def find_quick_room(plan: DecidedPlan, wanted: Sequence[Task]) -> QuickRoom | None:
    """Places for all ``wanted`` tasks; None where this search knows none, which says nothing."""
    search = _build_sharing(plan, wanted)
    if search is None:
        return None
    home, causes = dict(search.at), {task.name: task.name for task in wanted}
    pool = [task.name for task in wanted]
    while pool:
        pool.sort(key=lambda name: search.movers[name].size)
        name = pool.pop()
        cause = causes[name]
        moved = _insert_directly(search, name) or _share_out(search, name)
        if not moved:
            moved = _replace_smaller(search, name)
            pool += moved[:1]
        if not moved:
            return None
        causes |= dict.fromkeys(moved, cause)
    _restore_homes(search, home)
    places = {name: place for name, place in search.at.items() if home.get(name) != place}
    return QuickRoom(places, {name: causes[name] for name in places})


def _build_sharing(plan: DecidedPlan, wanted: Sequence[Task]) -> _Sharing | None:
    """The search, with all that may move; None where a ``wanted`` task may not be weighed this way."""
    fleet, ledger = plan.context.fleet, plan.ledger
    hosts = _list_hosts(plan)
    if plan.context.placement_rules is not NO_RULES or len(hosts) < 2:
        return None
    cpu, memory = fleet.usable[CPU.name], fleet.usable[MEMORY.name]
    whole = sum([cpu[place] for place in hosts]), sum([memory[place] for place in hosts])
    names, among = {task.name for task in wanted}, {*hosts}
    lowest = min([task.priority for task in wanted])
    movers: dict[str, _Mover] = {}
    on: list[dict[str, _Mover]] = [{} for _ in fleet.places]
    at: dict[str, int] = {}
    for task in plan.order:
        name = task.name
        place = plan.placed[name][0] if name in plan.placed else -1
        movable = place in among and task.priority <= lowest and name not in plan.initial.running
        mover = _build_mover(plan, task, whole) if movable or name in names else None
        if mover is not None:
            movers[name] = mover
            if movable:
                at[name] = place
                on[place][name] = mover
    free = _list_free(cpu, ledger.used[CPU.name]), _list_free(memory, ledger.used[MEMORY.name])
    if not names <= movers.keys() or not _has_room_for_all(
        hosts, free, [movers[each.name] for each in wanted]
    ):
        return None
    return _Sharing(
        plan=plan,
        hosts=hosts,
        cpu=free[0],
        memory=free[1],
        movers=movers,
        on=on,
        at=at,
        doubles=[
            (one, other, cpu[one] + cpu[other], memory[one] + memory[other])
            for one, other in combinations(hosts, 2)
        ],
        pairs=min(MAX_PAIRS, max(MIN_PAIRS, PAIRS_PER_TASK * len(wanted))),
    )


def _list_free(usable: Sequence[float], used: Sequence[float]) -> list[float]:
    return [most * (1 + _TOLERANCE) - taken for most, taken in zip(usable, used, strict=True)]


def _has_room_for_all(hosts: Sequence[int], free: tuple[Sequence[float], ...], new: Sequence[_Mover]) -> bool:
    needs = sum([each.cpu for each in new]), sum([each.memory for each in new])
    return all(need <= sum([row[place] for place in hosts]) for need, row in zip(needs, free, strict=True))


def _list_hosts(plan: DecidedPlan) -> list[int]:
    """Edges that are overcommitted in nothing, the emptiest first, so that names count only among equals."""
    fleet, free = plan.context.fleet, plan.ledger.free
    rows = [free[name] for name in fleet.counted]
    cpu, memory = fleet.usable[CPU.name], fleet.usable[MEMORY.name]
    found = [
        edge
        for edge in range(fleet.edges)
        if 0 < cpu[edge] < inf and 0 < memory[edge] < inf and min([row[edge] for row in rows]) >= 0
    ]
    found.sort(key=lambda edge: (*[-row[edge] for row in rows], fleet.order[edge]))
    return found[:MAX_HOSTS]


def _build_mover(plan: DecidedPlan, task: Task, whole: tuple[float, float]) -> _Mover | None:
    """``task`` as one that may move; None if it may not, or if its demand depends on the host."""
    fleet, demand = plan.context.fleet, task.demand
    if task.name in fleet.demands or task.name in fleet.floors or task.hard_deadline or task.hosts.pin:
        return None
    if any(map(demand.__getitem__, _OPTIONAL)):
        return None
    cpu, memory, rate = demand[CPU.name] or ZERO, demand[MEMORY.name] or ZERO, demand[NETWORK.name] or ZERO
    if cpu.relative or memory.relative or rate.relative:
        return None
    size = cpu.value / whole[0] + memory.value / whole[1]
    return _Mover(task, cpu.value, memory.value, rate.value, size, get_edge_rejections(plan.context, task))


def _insert_directly(search: _Sharing, name: str) -> list[str]:
    """Put the task ``name`` where the most is left of what is scarcest; empty where it fits nowhere."""
    mover, cpu, memory = search.movers[name], search.cpu, search.memory
    places = [
        place
        for place in search.hosts
        if cpu[place] >= mover.cpu and memory[place] >= mover.memory and place not in mover.denied
    ]
    places = [place for place in places if _carry_links(search, {name: place})]
    if not places:
        return []
    _put_mover(search, name, max(places, key=lambda place: _rate_spare(search, place, mover)))
    return [name]


def _rate_spare(search: _Sharing, place: int, mover: _Mover) -> float:
    usable = search.plan.context.fleet.usable
    return min(
        (search.cpu[place] - mover.cpu) / usable[CPU.name][place],
        (search.memory[place] - mover.memory) / usable[MEMORY.name][place],
    )


def _share_out(search: _Sharing, name: str) -> list[str]:
    """Put the task ``name`` on one of two hosts of which tasks change places, those with the most to spare
    first; empty where no two are found. The tasks that have another place then.
    """
    mover, cpu, memory = search.movers[name], search.cpu, search.memory
    need, room = mover.cpu, mover.memory
    found = [
        (min(spare / cores, left / size), one, other, spare / cores > left / size)
        for one, other, cores, size in search.doubles
        if (spare := cpu[one] + cpu[other] - need) >= 0 and (left := memory[one] + memory[other] - room) >= 0
    ]
    found.sort(key=itemgetter(0), reverse=True)
    for _, one, other, by_memory in found:
        hosts = (other, one) if one in mover.denied else (one, other)
        moved = _share_out_between(search, mover, hosts, by_memory=by_memory)
        if moved:
            return moved
    return []


def _replace_smaller(search: _Sharing, name: str) -> list[str]:
    """Put the task ``name`` on one of two hosts of which a smaller one, the smallest possible, leaves both:
    it is named first. Empty where none is found.
    """
    movers, cpu, memory = search.movers, search.cpu, search.memory
    mover = movers[name]
    others = [each for each in search.at if movers[each].size < mover.size]
    others.sort(key=lambda each: movers[each].size)
    for other in others:
        one, smaller = search.at[other], movers[other]
        spare, left = cpu[one] + smaller.cpu - mover.cpu, memory[one] + smaller.memory - mover.memory
        for place in search.hosts:
            if place != one and spare + cpu[place] >= 0 and left + memory[place] >= 0:
                moved = _share_out_between(search, mover, (one, place), without=other)
                if moved:
                    return [other, *moved]
    return []


def _share_out_between(
    search: _Sharing, new: _Mover, hosts: tuple[int, int], *, by_memory: bool = False, without: str = ""
) -> list[str]:
    """Put ``new`` on one of two ``hosts``, the first of which its rules permit, with their tasks shared out
    anew; empty where no way is found, or no more are to be tried. ``by_memory``: less of that is to spare;
    ``without``: a task of the first host that leaves both.
    """
    search.pairs -= 1
    one, other = hosts
    if search.pairs < 0 or one in new.denied:
        return []
    smaller = search.on[one].get(without)
    leaving = [
        each for each in (new, *search.on[one].values()) if each is not smaller and other not in each.denied
    ]
    coming = [each for each in search.on[other].values() if one not in each.denied]
    names = [each.task.name for each in leaving + coming][:MAX_CHANGES]
    cpu = [-each.cpu for each in leaving] + [each.cpu for each in coming]
    memory = [-each.memory for each in leaving] + [each.memory for each in coming]
    freed = (0.0, 0.0) if smaller is None else (smaller.cpu, smaller.memory)
    ranges = [
        Range(cpu[:MAX_CHANGES], -search.cpu[other], search.cpu[one] + freed[0] - new.cpu),
        Range(memory[:MAX_CHANGES], -search.memory[other], search.memory[one] + freed[1] - new.memory),
    ]
    if by_memory:
        ranges.reverse()
    goals: dict[str, int] = {}

    def accepts(found: Sequence[int]) -> bool:
        goals.clear()
        goals[new.task.name] = one
        goals.update({names[index]: other if index < len(leaving) else one for index in found})
        return _carry_links(search, goals)

    if find_changes(ranges[0], ranges[1], accepts) is None:
        return []
    for name in (without, *goals):
        if name in search.at:
            _take_mover(search, name)
    for name, goal in goals.items():
        _put_mover(search, name, goal)
    return list(goals)


def _carry_links(search: _Sharing, goals: Mapping[str, int]) -> bool:
    """Whether the links to robots carry enough with each task at its place of ``goals``."""
    added: dict[tuple[str, int], float] = {}
    for name, goal in goals.items():
        for robot in search.movers[name].task.robots:
            added[robot, goal] = added.get((robot, goal), 0.0) + search.movers[name].rate
    for name in goals:
        for robot in search.movers[name].task.robots if name in search.at else ():
            link = robot, search.at[name]
            if link in added:
                added[link] -= search.movers[name].rate
    return all(_get_free_rate(search, *link) >= rate for link, rate in added.items())


def _get_free_rate(search: _Sharing, robot: str, edge: int) -> float:
    """What is free of the link from ``edge`` to ``robot``, bytes/s; below 0 where there is none."""
    capacity = search.plan.context.fleet.links[robot][edge]
    if not capacity:
        return -1.0
    used = search.plan.ledger.links[robot][edge] + search.carried.get((robot, edge), 0.0)
    return capacity * (1 + _TOLERANCE) - used


def _put_mover(search: _Sharing, name: str, place: int) -> None:
    mover = search.movers[name]
    search.at[name] = place
    search.on[place][name] = mover
    _charge(search, mover, place, 1)


def _take_mover(search: _Sharing, name: str) -> None:
    place = search.at.pop(name)
    _charge(search, search.on[place].pop(name), place, -1)


def _charge(search: _Sharing, mover: _Mover, place: int, sign: int) -> None:
    search.cpu[place] -= sign * mover.cpu
    search.memory[place] -= sign * mover.memory
    for robot in mover.task.robots:
        search.carried[robot, place] = search.carried.get((robot, place), 0.0) + sign * mover.rate


def _restore_homes(search: _Sharing, home: Mapping[str, int]) -> None:
    """Put tasks back where they were, if they still fit there."""
    for name, place in home.items():
        mover = search.movers[name]
        if (
            search.at[name] != place
            and search.cpu[place] >= mover.cpu
            and search.memory[place] >= mover.memory
            and _carry_links(search, {name: place})
        ):
            _take_mover(search, name)
            _put_mover(search, name, place)
