# SPDX-License-Identifier: Apache-2.0
"""The first search for room: what it finds keeps every bound and rule, and moves only what may move."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from random import Random

import pytest

from edgectl.model.demand import ZERO
from edgectl.model.task import Task
from edgectl.scheduler.decided_plan import DecidedPlan, list_wanted
from edgectl.scheduler.quick_room import QuickRoom, find_quick_room
from tests.benchmarks.repair import collect_plans
from tests.builders import a_link
from tests.scheduler.fleets import simulate_apply
from tests.scheduler.tight_fleets import LINK, ROBOTS, TightFleet, build_full_fleet

SEEDS = range(24)


def search_fleet(fleet: TightFleet) -> tuple[DecidedPlan, QuickRoom | None] | None:
    """The plan in which a task found no room, and what the search finds; None where all have room."""
    plans = collect_plans([fleet])
    return (plans[0], find_quick_room(plans[0], list_wanted(plans[0]))) if plans else None


def change_tasks(fleet: TightFleet, change: Callable[[int, Task], Task]) -> TightFleet:
    tasks = {name: change(index, task) for index, (name, task) in enumerate(fleet.tasks.tasks.items())}
    return replace(fleet, tasks=replace(fleet.tasks, tasks=tasks))


def restrict_hosts(fleet: TightFleet, dice: Random) -> TightFleet:
    """Every second task is not allowed on one or two hosts."""
    edges = [*fleet.snapshot.hosts]

    def restrict(index: int, task: Task) -> Task:
        never = tuple(dice.sample(edges, dice.choice([1, 2]))) if index % 2 else ()
        return replace(task, hosts=replace(task.hosts, never=never))

    return change_tasks(fleet, restrict)


def pin_some(fleet: TightFleet, dice: Random) -> TightFleet:
    """Every fourth task is pinned to some host."""
    edges = [*fleet.snapshot.hosts]

    def pin(index: int, task: Task) -> Task:
        return replace(task, hosts=replace(task.hosts, pin=None if index % 4 else dice.choice(edges)))

    return change_tasks(fleet, pin)


def rank_tasks(fleet: TightFleet, dice: Random) -> TightFleet:
    """Every fifth task, about, is of higher priority, and so first in the sequence."""
    return change_tasks(fleet, lambda _, task: replace(task, priority=float(dice.random() < 0.2)))


def narrow_links(fleet: TightFleet, dice: Random) -> TightFleet:
    """Links of which some are missing and most are nearly full."""
    hosts = {
        name: replace(
            host,
            links={robot: a_link(LINK * dice.uniform(0.03, 0.2)) for robot in ROBOTS if dice.random() < 0.95},
        )
        for name, host in fleet.snapshot.hosts.items()
    }
    return replace(fleet, snapshot=replace(fleet.snapshot, hosts=hosts))


def run_half(fleet: TightFleet, dice: Random) -> TightFleet:
    """Half of the tasks run where a plan of them alone puts them."""
    names = set(dice.sample([*fleet.tasks.tasks], len(fleet.tasks.tasks) // 2))
    some = replace(
        fleet.tasks, tasks={name: each for name, each in fleet.tasks.tasks.items() if name in names}
    )
    first = replace(fleet, tasks=some).assign()
    snapshot, memory = simulate_apply(first, some, fleet.snapshot, fleet.memory)
    return replace(fleet, snapshot=snapshot, memory=memory)


def leave_alone(fleet: TightFleet, _dice: Random) -> TightFleet:
    return fleet


@pytest.mark.parametrize(
    ("vary", "least"),
    [
        (leave_alone, 12),
        (restrict_hosts, 1),
        (pin_some, 1),
        (rank_tasks, 1),
        (narrow_links, 1),
        (run_half, 1),
    ],
)
def test_what_it_finds_keeps_every_bound(
    vary: Callable[[TightFleet, Random], TightFleet], least: int
) -> None:
    found = 0
    for seed in SEEDS:
        searched = search_fleet(vary(build_full_fleet(5, 20, seed), Random(seed)))
        plan, room = searched or (None, None)
        if plan is not None and room is not None:
            check_places(plan, room)
            found += 1
    assert found >= least


def check_places(plan: DecidedPlan, room: QuickRoom) -> None:
    fleet, wanted = plan.context.fleet, [task.name for task in list_wanted(plan)]
    tasks = {task.name: task for task in plan.order}
    places = {name: place for name, (place, _) in plan.placed.items()} | dict(room.places)
    assert set(wanted) <= places.keys()
    assert set(room.causes) == set(room.places)
    assert set(room.causes.values()) <= set(wanted)
    lowest = min(tasks[name].priority for name in wanted)
    for name, place in room.places.items():
        task, host = tasks[name], fleet.places[place].name
        assert name in wanted or (name not in plan.initial.running and task.priority <= lowest)
        assert host not in task.hosts.never
        assert task.hosts.pin is None
        assert place < fleet.edges
    for resource in ("cpu", "memory"):
        used: Counter[int] = Counter()
        for name, place in places.items():
            used[place] += (tasks[name].demand[resource] or ZERO).value  # type: ignore[assignment]
        for place, amount in used.items():
            assert amount <= fleet.usable[resource][place] * (1 + 1e-9)
    rates: Counter[tuple[str, int]] = Counter()
    for name, place in places.items():
        for robot in tasks[name].robots:
            rates[robot, place] += (tasks[name].demand["network"] or ZERO).value  # type: ignore[assignment]
    for (robot, place), rate in rates.items():
        assert rate <= (fleet.links[robot][place] or 0.0) * (1 + 1e-9)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"hard_deadline": True, "deadline": 0.1}, id="hard deadline"),
        pytest.param({"apart": ("task00",)}, id="rule between tasks"),
    ],
)
def test_it_leaves_to_others_what_it_does_not_know(change: dict[str, object]) -> None:
    for seed in (0, 1, 5):
        fleet = build_full_fleet(5, 20, seed)
        searched = search_fleet(fleet)
        assert searched is not None
        assert searched[1] is not None
        name = list_wanted(searched[0])[0].name
        task = replace(fleet.tasks.tasks[name], **change)  # type: ignore[arg-type]
        other = replace(fleet.tasks, tasks={**fleet.tasks.tasks, name: task})
        again = search_fleet(replace(fleet, tasks=other))
        assert again is None or again[1] is None
