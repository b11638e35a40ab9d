# SPDX-License-Identifier: Apache-2.0
"""Settings of a sweep, and the shared radio, against closed forms."""

from dataclasses import replace

import pytest

from edgectl.experiments.files.sweep_worlds import SETTINGS, World
from edgectl.experiments.model.mission_event import LinkChange, MissionEvent
from edgectl.experiments.model.scenario import Radio, Scenario, SimHost, SimJob, SimLink, SimRun, SimTiming
from edgectl.experiments.simulator import simulate_mission
from edgectl.model.policy import Policy
from tests.builders import GI, a_robot, a_task, an_edge, an_inventory, some_tasks

FLEET = an_inventory(
    an_edge("edge2", cpu_limit=10.0),
    an_edge("edge1", cpu_limit=10.0),
    *(a_robot(name) for name in ("robot3", "robot2", "robot1")),
    links={(edge, f"robot{number}"): 1e6 for edge in ("edge1", "edge2") for number in (1, 2, 3)},
)
HOSTS = {name: SimHost(cores=4.0, memory=4 * GI) for name in FLEET.hosts}
SCENARIO = Scenario(
    name="test",
    assumptions=(),
    hosts=HOSTS,
    jobs=(),
    links=(
        SimLink(edge="edge1", robot="robot2", throughput=0.1e6),
        SimLink(edge="edge2", robot="robot1", throughput=1e6, after=("a",)),
        SimLink(edge="edge1", robot="robot3", throughput=0.0),
    ),
    events=(
        MissionEvent(name="far", at=1.0, link=LinkChange(edge="edge2", robot="robot3", throughput=0.25e6)),
        MissionEvent(name="slow", at=1.0, link=LinkChange(edge="edge2", robot="robot2", delay=0.1)),
    ),
)
WORLD = World(FLEET, SCENARIO, Policy())


def test_a_ratio_sets_what_slow_links_carry_and_nothing_else() -> None:
    found = SETTINGS["link_ratio"](WORLD, 20.0).scenario
    assert [link.throughput for link in found.links] == [1e6 / 20, 1e6, 0.0]
    changes = [event.link for event in found.events]
    assert [change.throughput for change in changes if change is not None] == [1e6 / 20, None]


def test_robots_get_other_cores_and_edges_keep_theirs() -> None:
    hosts = SETTINGS["robot_cores"](WORLD, 0.5).scenario.hosts
    assert {name: host.cores for name, host in hosts.items()} == {
        name: 0.5 if name.startswith("robot") else 4.0 for name in FLEET.hosts
    }


def test_the_other_settings_reach_timing_and_policy() -> None:
    world = WORLD
    for name, value in {
        "noise": 0.1,
        "every": 7.0,
        "margin": 0.6,
        "dwell": 90.0,
        "radio": Radio.SHARED,
    }.items():
        world = SETTINGS[name](world, value)
    assert (world.scenario.timing.noise, world.scenario.timing.every) == (0.1, 7.0)
    assert (world.policy.move_margin, world.policy.min_dwell) == (0.6, 90.0)
    assert world.scenario.radio is Radio.SHARED


def run_flows(radio: Radio, **rates: float) -> SimRun:
    """A mission of a task per robot on one edge, each with a flow; links of 1, .5 and .25 MB/s."""
    tasks = [
        a_task(f"send-{robot}", cpu=0.1, throughput=rate, robots=(robot,), only=["edge1"])
        for robot, rate in rates.items()
    ]
    links = (
        SimLink(edge="edge1", robot="robot2", throughput=0.5e6),
        SimLink(edge="edge1", robot="robot3", throughput=0.25e6),
    )
    scenario = replace(
        SCENARIO,
        links=links,
        events=(),
        live_links=False,
        radio=radio,
        jobs=tuple(SimJob(name=task.name, task=task.name, work=100.0) for task in tasks),
        timing=SimTiming(start=0.0, stop=0.0, every=1000.0, limit=10_000.0),
    )
    return simulate_mission(FLEET, some_tasks(*tasks), scenario, Policy(best_effort=True), lambda: 0.0)


def test_one_channel_divides_its_time_and_not_its_bytes() -> None:
    # Air time that is asked for: .4 / 1, .2 / .5, .1 / .25 = .4 each; 1.2 in all, so each gets a third: 5/6 of its speed.
    wanted = {"robot3": 0.1e6, "robot2": 0.2e6, "robot1": 0.4e6}
    assert run_flows(Radio.SEPARATE, **wanted).latency == pytest.approx(100.0)
    assert run_flows(Radio.SHARED, **wanted).latency == pytest.approx(120.0)


def test_a_flow_that_asks_for_less_than_its_share_gets_it_all() -> None:
    # robot1 asks for .1 of the time; robot3 asks for all of it, on the slow link, and gets the rest: .9.
    found = run_flows(Radio.SHARED, robot3=0.25e6, robot1=0.1e6)
    assert found.jobs["send-robot1"] == pytest.approx(100.0)
    # The task of robot1 goes on to send until the next plan.
    assert found.jobs["send-robot3"] == pytest.approx(100.0 / 0.9)
