# SPDX-License-Identifier: Apache-2.0
"""Missions of tasks that work on one item after the other, against closed forms."""

from dataclasses import replace

import pytest

from edgectl.experiments.model.mission_event import (
    DemandChange,
    EventCondition,
    HostLoad,
    LinkChange,
    MissionEvent,
)
from edgectl.experiments.model.scenario import Radio, Scenario, SimCycle, SimHost, SimJob, SimRun, SimTiming
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.policy import Policy
from edgectl.model.task import Task
from tests.builders import GI, a_robot, a_task, an_edge, an_inventory, some_tasks

ROBOTS = ("robot3", "robot1")
FLEET = an_inventory(
    an_edge("zeta"),
    an_edge("beta"),
    *(a_robot(name, onboard=True) for name in ROBOTS),
    links={(edge, robot): 1e6 for edge in ("zeta", "beta") for robot in ROBOTS},
)
HOSTS = {"zeta": 1.0, "beta": 0.5, "robot3": 0.5, "robot1": 0.5}
TIMING = SimTiming(start=0.0, stop=0.0, every=10.0, limit=10_000.0)
LOOK = SimCycle(rate=5.0, cpu=0.02, transfer=2e5, source="camera", source_cpu=0.01)


def tasks(host: str = "zeta") -> list[Task]:
    return [
        a_task("look", cpu=0.1, throughput=1e5, robots=["robot3"], only=[host]),
        a_task("camera", cpu=0.05, only=["robot3"], robots=["robot3"]),
        a_task("drive", cpu=0.01, only=["robot3"], robots=["robot3"]),
    ]


def world(*jobs: SimJob, events: tuple[MissionEvent, ...] = (), **cycles: SimCycle) -> Scenario:
    return Scenario(
        name="test",
        assumptions=(),
        hosts={name: SimHost(cores=cores, memory=4 * GI) for name, cores in HOSTS.items()},
        jobs=jobs,
        timing=TIMING,
        events=events,
        cycles=cycles or {"look": LOOK},
    )


def run(scenario: Scenario, host: str = "zeta") -> SimRun:
    return simulate_mission(FLEET, some_tasks(*tasks(host)), scenario, Policy(min_dwell=0.0), lambda: 0.0)


LOOKED = SimJob(name="look", task="look", work=60.0)
# Made in 0.01 s / 0.44 cores (the camera and the drive take 0.06 of 0.5), fetched in 0.2 s, looked at in 0.02 s / 1 core.
TAKES_S = 0.01 / 0.44 + 0.2 + 0.02


def test_items_one_after_the_other() -> None:
    """At 1 MB/s an item takes more than the fifth of a second in which the next one is due."""
    found = run(world(LOOKED))
    assert found.latency == pytest.approx(60.0 * 5 * TAKES_S, rel=1e-3)
    assert found.usage["zeta"].cpu == pytest.approx(0.02 / TAKES_S, rel=1e-3)
    assert found.usage["zeta"].network_bytes_per_s == pytest.approx(2e5 / TAKES_S, rel=1e-3)
    assert found.usage["robot3"].cpu == pytest.approx((0.06 + 0.01 / TAKES_S) / 0.5, rel=1e-2)


def test_on_its_robot_it_fetches_nothing() -> None:
    found = run(world(LOOKED), host="robot3")
    assert found.latency == pytest.approx(60.0, rel=1e-3)
    assert found.usage["robot3"].network_bytes_per_s == 0.0


def test_a_source_that_never_runs_gives_nothing() -> None:
    scenario = replace(
        world(LOOKED), timing=replace(TIMING, limit=50.0), cycles={"look": replace(LOOK, source="none")}
    )
    assert not run(scenario).finished


def test_a_slower_link_and_more_work_from_a_moment_on() -> None:
    """Half of the work before; then ten times as long on the link, and from the same moment 0.1 s of CPU."""
    half = replace(LOOKED, name="half", work=30.0)
    rest = replace(LOOKED, name="rest", work=30.0, after=("half",))
    when = EventCondition(jobs=("half",))
    events = (
        MissionEvent(name="far", when=when, link=LinkChange(edge="zeta", robot="robot3", throughput=1e5)),
        MissionEvent(name="grown", when=when, demand=DemandChange(task="look", demand={"cpu": 0.5})),
    )
    found = run(world(half, rest, events=events))
    later = 0.01 / 0.44 + 2.0 + 0.1
    assert found.latency == pytest.approx(30.0 * 5 * (TAKES_S + later), rel=2e-3)


def test_beside_a_stranger_it_has_its_share() -> None:
    """Two processes of another take two thirds of the edge, from 10 s on."""
    stranger = MissionEvent(name="stranger", at=10.0, load=HostLoad(host="zeta", cpu=2.0))
    found = run(world(LOOKED, events=(stranger,)))
    left = 300 - 10 / TAKES_S
    assert found.latency == pytest.approx(10 + left * (TAKES_S + 0.04), rel=2e-3)


def test_links_that_share_the_air() -> None:
    """Two that take the whole time of one channel each get half of it."""
    scenario = replace(
        world(LOOKED, replace(LOOKED, name="other", task="other"), look=LOOK, other=replace(LOOK, source="")),
        radio=Radio.SHARED,
    )
    other = a_task("other", cpu=0.1, throughput=1e5, robots=["robot1"], only=["beta"])
    policy = Policy(min_dwell=0.0)
    separate, shared = (
        simulate_mission(FLEET, some_tasks(*tasks(), other), each, policy, lambda: 0.0).latency
        for each in (replace(scenario, radio=Radio.SEPARATE), scenario)
    )
    assert 1.5 * separate < shared < 2.0 * separate


def test_a_job_waits_for_fresh_results() -> None:
    """Results are TAKES_S old when they come, and then grow older until the next one."""
    blind = SimJob(name="drive", task="drive", work=60.0)
    seeing = replace(blind, senses=("look",), fresh=0.1)
    assert run(world(blind)).latency == pytest.approx(60.0)
    assert run(world(seeing)).latency == pytest.approx(60.0 * 1.5 * TAKES_S / 0.1, rel=2e-3)
    assert run(world(replace(seeing, fresh=1.0))).latency == pytest.approx(60.0)


def test_plans_begin_in_step_whatever_they_take() -> None:
    """Reading takes 1 s, a start 3 s, the rest of a plan with steps 2 s: the first takes 6 s of a period of 4 s."""
    timing = SimTiming(start=3.0, every=4.0, probe=1.0, apply=2.0, paced=True, limit=1000.0)
    late = MissionEvent(name="late", at=5.0, add="drive")
    scenario = replace(world(SimJob(name="drive", task="drive", work=10.0), events=(late,)), timing=timing)
    assert run(scenario).latency == pytest.approx(8.0 + 1.0 + 3.0 + 10.0)
    assert run(replace(scenario, timing=replace(timing, paced=False))).latency == pytest.approx(
        10.0 + 1.0 + 3.0 + 10.0
    )
