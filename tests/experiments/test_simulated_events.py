# SPDX-License-Identifier: Apache-2.0
"""Events of simulated missions against closed forms, on three edges whose names are in reverse order."""

import random
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from edgectl.experiments.event_draws import build_uniform_draw
from edgectl.experiments.model.mission_event import (
    DemandChange,
    EventCondition,
    HostLoad,
    LinkChange,
    MissionEvent,
    RobotProgress,
    select_present_tasks,
)
from edgectl.experiments.model.scenario import Scenario, SimHost, SimJob, SimRun, SimTiming
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.task import Task, UnreachablePolicy
from tests.builders import GI, a_robot, a_task, an_edge, an_inventory, some_tasks

FLEET = an_inventory(
    an_edge("zinc"),
    an_edge("mint"),
    an_edge("alder"),
    a_robot("rover2"),
    a_robot("rover1"),
    links={(edge, robot): 1e6 for edge in ("zinc", "mint", "alder") for robot in ("rover1", "rover2")},
)
UTILITY = Policy(min_dwell=0.0)
STILL: Callable[[], float] = lambda: 0.0  # noqa: E731


def simulate(
    events: tuple[MissionEvent, ...], *tasks: Task, policy: Policy = UTILITY, seed: int = 1, **work: float
) -> SimRun:
    """One mission of a job for each task, of 100 s or as ``work`` says; a plan every 10 s, starts take no time."""
    jobs = tuple(
        SimJob(name=f"do-{task.name}", task=task.name, work=work.get(task.name, 100.0)) for task in tasks
    )
    return run_scenario(build_scenario(events, jobs), *tasks, policy=policy, seed=seed)


def build_scenario(events: tuple[MissionEvent, ...], jobs: tuple[SimJob, ...], **fields: Any) -> Scenario:
    hosts = {
        name: SimHost(cores=4.0 if host in FLEET.edges else 1.0, memory=4 * GI)
        for name, host in FLEET.hosts.items()
    }
    timing = SimTiming(start=0.0, stop=0.0, every=10.0, limit=1000.0)
    return replace(
        Scenario(name="test", assumptions=(), hosts=hosts, jobs=jobs, timing=timing, events=events), **fields
    )


def run_scenario(scenario: Scenario, *tasks: Task, policy: Policy = UTILITY, seed: int = 1) -> SimRun:
    draws = partial(random.Random(seed).gauss, 0.0, 1.0) if scenario.timing.noise else STILL
    return simulate_mission(FLEET, some_tasks(*tasks), scenario, policy, draws, build_uniform_draw(str(seed)))


def close_to(value: float) -> Any:
    return pytest.approx(value, abs=1e-6)


def test_a_stranger_takes_its_fair_share_while_it_is_there() -> None:
    """3 of 4 cores are wanted, and 4 by the stranger: 2 each, so that 30 s yield 20 s of work."""
    load = MissionEvent(name="s", at=20.0, duration=30.0, load=HostLoad(host="zinc", cpu=4.0))
    run = simulate((load,), a_task("t", cpu=3.0, only=["zinc"]))
    assert run.latency == close_to(110.0)
    assert [(each.event, each.kind, each.subject, each.at, each.until) for each in run.events] == [
        ("s", "load", "zinc", 20.0, 50.0)
    ]


def test_a_task_leaves_a_host_that_a_stranger_loads() -> None:
    """The plan at 30 s sees the load and finds 4 free cores elsewhere; a move takes no time here."""
    load = MissionEvent(name="s", at=25.0, load=HostLoad(host="zinc", cpu=4.0, memory=GI))
    task = a_task("t", cpu=3.0, never=["alder"])
    stays = simulate((load,), a_task("t", cpu=3.0, only=["zinc"]))
    goes = simulate((replace(load, load=HostLoad(host=find_first_host(task), cpu=4.0)),), task)
    assert (stays.handoffs, goes.handoffs) == (0, 1)
    assert stays.latency == close_to(25.0 + 75.0 * 1.5)
    assert goes.latency == close_to(30.0 + 100.0 - 25.0 - 5.0 / 1.5)


def find_first_host(task: Task) -> str:
    """The edge that the plan at 0 s chooses: the only one with a load under no event."""
    run = simulate((), task)
    return next(name for name, usage in run.usage.items() if usage.cpu > 0.0)


def test_a_link_carries_less_for_a_time() -> None:
    """0.8 MB/s are wanted of 1 MB/s; for 40 s the link carries 0.2 MB/s: a quarter of the speed."""
    event = MissionEvent(
        name="far", at=10.0, duration=40.0, link=LinkChange(edge="zinc", robot="rover2", throughput=2e5)
    )
    task = a_task("t", cpu=1.0, throughput=8e5, robots=["rover2"], only=["zinc"])
    assert simulate((event,), task).latency == close_to(100.0 + 30.0)
    other = replace(event, link=LinkChange(edge="zinc", robot="rover1", throughput=2e5))
    assert simulate((other,), task).latency == close_to(100.0)


def test_a_task_leaves_a_link_that_became_slow() -> None:
    event = MissionEvent(name="far", at=15.0, link=LinkChange(edge="zinc", robot="rover2", throughput=1e5))
    task = a_task("t", cpu=1.0, throughput=8e5, robots=["rover2"], never=["alder"])
    first = find_first_host(task)
    change = LinkChange(edge=first, robot="rover2", throughput=1e5)
    run = simulate((replace(event, link=change),), task)
    assert run.handoffs == 1
    assert run.latency == close_to(20.0 + 100.0 - 15.0 - 5.0 / 8.0)


def test_tasks_of_a_lost_host_wait_for_it() -> None:
    """Off from 15 s to 32 s; the plan at 40 s starts the task again. The work of 15 s is done."""
    event = MissionEvent(name="off", at=15.0, duration=17.0, lost="zinc")
    run = simulate((event,), a_task("t", cpu=1.0, only=["zinc"]))
    assert run.latency == close_to(40.0 + 85.0)
    assert (run.handoffs, run.events[0].until) == (0, 32.0)


def test_tasks_that_may_be_replaced_are_started_elsewhere_once_it_is_certain() -> None:
    """Last heard of at 20 s, certain 30 s later; the plan at 50 s starts it on another edge."""
    task = replace(
        a_task("t", cpu=1.0),
        on_unreachable=UnreachablePolicy.REPLACE,
        self_fence=0.0,
        replace_after=30.0,
    )
    event = MissionEvent(name="off", at=25.0, lost=find_first_host(task))
    run = simulate((event,), task)
    assert run.latency == close_to(50.0 + 75.0)


def test_a_lost_robot_stops_what_serves_it() -> None:
    event = MissionEvent(name="off", at=15.0, duration=20.0, lost="rover1")
    task = a_task("t", cpu=1.0, throughput=1e5, robots=["rover1"], only=["zinc"])
    other = a_task("u", cpu=1.0, throughput=1e5, robots=["rover2"], only=["zinc"])
    assert simulate((event,), task, other).jobs == {"do-t": close_to(120.0), "do-u": close_to(100.0)}


def test_a_need_that_is_lost_during_its_start_blocks_no_plan() -> None:
    """The need starts at 0 s for 5 s, and its host is off from 2 s to 8 s: both start with the plan at 15 s."""
    tasks = (a_task("need", cpu=1.0, only=["mint"]), a_task("t", cpu=1.0, needs=["need"], only=["zinc"]))
    event = MissionEvent(name="off", at=2.0, duration=6.0, lost="mint")
    scenario = build_scenario((event,), (SimJob(name="do", task="t", work=50.0),))
    scenario = replace(scenario, timing=replace(scenario.timing, start=5.0))
    assert run_scenario(scenario, *tasks).latency == close_to(15.0 + 5.0 + 5.0 + 50.0)


def test_tasks_of_a_robot_enter_when_it_joins() -> None:
    """Nothing of rover2 runs before the plan that follows on 22 s; what needs its task waits, too."""
    tasks = (
        a_task("a", cpu=1.0, robots=["rover2"], only=["zinc"]),
        a_task("b", cpu=1.0, robots=["rover1"], only=["mint"]),
        a_task("c", cpu=1.0, needs=["a"], only=["alder"]),
    )
    run = simulate((MissionEvent(name="in", at=22.0, join="rover2"),), *tasks)
    assert run.jobs == {"do-a": close_to(130.0), "do-b": close_to(100.0), "do-c": close_to(130.0)}
    present = select_present_tasks(some_tasks(*tasks), [MissionEvent(name="in", at=1.0, join="rover2")], ())
    assert list(present.tasks) == ["b"]


def test_a_task_is_added() -> None:
    added = MissionEvent(name="more", when=EventCondition(completed=("a",)), add="b")
    run = simulate((added,), a_task("a", cpu=1.0), a_task("b", cpu=1.0), a=33.0)
    assert run.jobs["do-b"] == close_to(40.0 + 100.0)
    assert run.events[0].at == close_to(33.0)


def test_a_demand_grows_and_the_profilers_see_it() -> None:
    """From 1 to 6 cores of 4: two thirds of the speed from 10 s on, and a host that is used fully."""
    grown = MissionEvent(name="more", at=10.0, demand=DemandChange(task="t", demand={"cpu": 6.0}))
    run = simulate((grown,), a_task("t", cpu=1.0, only=["zinc"]))
    assert run.latency == close_to(10.0 + 90.0 * 1.5)
    assert run.usage["zinc"].cpu_peak == close_to(1.0)


@pytest.mark.parametrize(
    ("condition", "at"),
    [
        (EventCondition(progress=RobotProgress(robot="rover1", reaches=0.25)), 58.75 / 1.5),
        (EventCondition(progress=RobotProgress(robot="rover2", reaches=0.5)), 150.0),
        (EventCondition(placed=("late",)), 60.0),
        (EventCondition(completed=("early",)), 55.0),
        (EventCondition(jobs=("do-early",)), 55.0),
        (EventCondition(jobs=("do-early",), progress=RobotProgress(robot="rover1", reaches=0.5)), 125.0),
    ],
)
def test_conditions_hold_at_their_moment(condition: EventCondition, at: float) -> None:
    """rover1: 55 s at full speed beside 180 s at half of it; rover2 begins at 60 s and needs 180 s."""
    tasks = (
        a_task("early", cpu=1.0, robots=["rover1"], only=["zinc"]),
        a_task("slow", cpu=8.0, robots=["rover1"], only=["mint"]),
        a_task("late", cpu=1.0, robots=["rover2"], only=["alder"]),
    )
    jobs = (
        SimJob(name="do-early", task="early", work=55.0),
        SimJob(name="do-slow", task="slow", work=180.0),
        SimJob(name="do-late", task="late", work=180.0),
    )
    events = (
        MissionEvent(name="late", when=EventCondition(completed=("early",)), add="late"),
        MissionEvent(name="seen", when=condition, load=HostLoad(host="zinc", cpu=0.1)),
    )
    scenario = build_scenario(events, jobs)
    policy = replace(UTILITY, best_effort=True)
    seen = [each.at for each in run_scenario(scenario, *tasks, policy=policy).events if each.event == "seen"]
    assert seen == [close_to(at)]


def test_repetitions_have_their_own_draws_whatever_else_is_drawn() -> None:
    """The same under schemes that draw other noise; each is late by less than the jitter, and never alike."""
    events = (
        MissionEvent(
            name="a",
            at=10.0,
            every=20.0,
            times=4,
            jitter=5.0,
            duration=5.0,
            load=HostLoad(host="mint", cpu=1.0),
        ),
        MissionEvent(name="b", at=10.0, every=20.0, jitter=5.0, load=HostLoad(host="alder", cpu=1.0)),
    )
    tasks = [a_task(name, cpu=1.0) for name in "xy"]
    scenario = build_scenario(events, tuple(SimJob(name=t.name, task=t.name, work=120.0) for t in tasks))
    noisy = replace(scenario, timing=replace(scenario.timing, noise=0.1))
    static = Policy(name=PolicyName.STATIC)
    records = [
        run_scenario(each, *tasks, policy=policy, seed=seed).events
        for each, policy, seed in (
            (scenario, UTILITY, 1),
            (noisy, static, 1),
            (replace(noisy, events=events[:1]), UTILITY, 1),
            (noisy, UTILITY, 2),
        )
    ]
    times = [[record.at for record in found if record.event == "a"] for found in records]
    assert times[0] == times[1] == times[2] != times[3]
    late = [at - 20.0 * number - 10.0 for number, at in enumerate(times[0])]
    assert len(late) == len(set(late)) == 4
    assert all(0.0 < each < 5.0 for each in late)
    assert len([record for record in records[0] if record.event == "b"]) > 4


def test_events_at_the_beginning_precede_the_first_plan() -> None:
    """No task ever runs on the edge that is off from the start."""
    task = a_task("t", cpu=1.0)
    first = find_first_host(task)
    run = simulate((MissionEvent(name="off", at=0.0, lost=first),), task)
    assert run.latency == close_to(100.0)
    assert run.usage[first].cpu == 0.0


def test_a_repeated_event_without_an_end_counts_again_when_it_happens() -> None:
    """A quarter of the link from 10 s and again from 50 s on, half of it from 30 s: 10 + 5 + 10 s of work until
    50 s, and 75 s at a quarter.
    """
    quarter, half = (LinkChange(edge="zinc", robot="rover2", throughput=share * 4e5) for share in (0.25, 0.5))
    again = MissionEvent(name="zap", at=10.0, every=40.0, times=2, link=quarter)
    once = MissionEvent(name="ant", at=30.0, link=half)
    task = a_task("t", cpu=1.0, throughput=4e5, robots=["rover2"], only=["zinc"])
    for events in ((again, once), (once, again)):
        assert simulate(events, task).latency == close_to(350.0)
