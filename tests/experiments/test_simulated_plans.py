# SPDX-License-Identifier: Apache-2.0
"""Between a reading and a move in the model, against closed forms: order and time of moves, and what readings miss."""

from dataclasses import replace

import pytest
import simpy

from edgectl.experiments.event_draws import build_uniform_draw
from edgectl.experiments.model.mission_event import (
    EventCondition,
    LinkChange,
    MissionEvent,
    RobotProgress,
)
from edgectl.experiments.model.scenario import SimJob, SimRun, SimTiming
from edgectl.experiments.simulator import begin_steps, simulate_mission
from edgectl.experiments.simulator_state import HostMeter, SimState, SimTask
from edgectl.model.plan import Action
from edgectl.model.policy import Policy
from tests.builders import a_robot, a_task, an_edge, an_inventory, some_tasks
from tests.executor.test_requests import a_step
from tests.experiments.test_simulated_cycles import FLEET, LOOK, LOOKED, world
from tests.experiments.test_simulated_cycles import TIMING as CYCLE_TIMING

TASKS = some_tasks(
    *(a_task(name, robots=["robot3"], throughput=1e5) for name in ("c", "b", "a")), a_task("free")
)
TIMING = SimTiming(start=4.0, stop=1.0, prepare=5.0, every=100.0)


def build_state(**places: str) -> SimState:
    """A state in which these tasks run there."""
    inventory = an_inventory(*map(an_edge, ("zinc", "mint", "alder")), a_robot("robot3"), a_robot("robot1"))
    hosts = dict.fromkeys(inventory.hosts, next(iter(world().hosts.values())))
    env = simpy.Environment()
    return SimState(
        env=env, inventory=inventory, tasks=TASKS, scenario=replace(world(), hosts=hosts, timing=TIMING, cycles={}),
        policy=Policy(), draw_normal=lambda: 0.0, changed=env.event(), read=env.event(), reference="zinc",
        meters={host: HostMeter() for host in inventory.hosts},
        services={name: SimTask(task=TASKS.tasks[name], host=host, since=0.0, ready=True) for name, host in places.items()},
    )  # fmt: skip


def test_a_move_waits_for_those_that_leave_its_host() -> None:
    """Each takes 5 s before the stop, 1 s to stop and 4 s to start. a comes where b leaves, and b where c leaves."""
    state = build_state(a="zinc", b="mint", c="alder", free="zinc")
    moves = [
        a_step("a", Action.MOVE, "mint", "zinc"),
        a_step("b", Action.MOVE, "alder", "mint"),
        a_step("c", Action.MOVE, "robot1", "alder"),
        a_step("free", Action.MOVE, "robot3", "zinc"),
    ]
    steps = begin_steps(state, moves)
    state.env.run(until=5.5)
    assert [name for name, each in state.services.items() if not each.ready] == ["c", "free"]
    state.env.run(until=simpy.AllOf(state.env, steps))
    assert state.env.now == 30.0
    started = {name: (each.host, each.since) for name, each in state.services.items()}
    assert started == {
        "c": ("robot1", 6.0),
        "free": ("robot3", 6.0),
        "b": ("alder", 16.0),
        "a": ("mint", 26.0),
    }


def test_a_plan_takes_its_time_before_the_first_step() -> None:
    """A reading of 1 s, 2 s to the first step, a start of 3 s; nothing is prepared for a first start."""
    timing = replace(CYCLE_TIMING, start=3.0, probe=1.0, plan=2.0, prepare=50.0)
    assert run(timing, SimJob(name="drive", task="drive", work=10.0)).latency == pytest.approx(16.0)


@pytest.mark.parametrize(("by_reading", "at"), [(False, 33.0), (True, 41.0)])
def test_a_condition_is_seen_at_once_or_by_the_next_reading(by_reading: bool, at: float) -> None:
    """A third of 90 s of work is done at 33 s: readings take 1 s, then a start 2 s, and the next one ends at 41 s."""
    third = EventCondition(progress=RobotProgress(robot="robot3", reaches=1 / 3))
    event = MissionEvent(name="far", when=third, link=LinkChange(edge="beta", robot="robot1", throughput=1e5))
    timing = replace(CYCLE_TIMING, start=2.0, probe=1.0, paced=True, by_reading=by_reading)
    drive = SimJob(name="drive", task="drive", work=90.0)
    assert [each.at for each in run(timing, drive, event).events] == pytest.approx([at])


@pytest.mark.parametrize(("share", "moves"), [(1.0, 1), (0.0, 0)])
def test_a_link_that_no_burst_shows_is_not_left(share: float, moves: int) -> None:
    """It carries a tenth from 15 s on, and only the traffic of the task on it can tell."""
    far = MissionEvent(name="far", at=15.0, link=LinkChange(edge="zeta", robot="robot3", throughput=1e5))
    timing = replace(CYCLE_TIMING, bursts=share)
    assert run(timing, replace(LOOKED, work=20.0), far, "zeta", "beta").handoffs == moves


def run(timing: SimTiming, job: SimJob, event: MissionEvent | None = None, *hosts: str) -> SimRun:
    """A mission of one job, beside the camera; ``hosts``: where it may be looked at."""
    tasks = some_tasks(
        a_task("look", cpu=0.1, throughput=1e5, robots=["robot3"], only=hosts or ["zeta"]),
        a_task("camera", cpu=0.05, only=["robot3"], robots=["robot3"]),
        a_task("drive", cpu=0.01, only=["robot3"], robots=["robot3"]),
    )
    scenario = replace(world(job, events=(event,) if event else (), look=LOOK), timing=timing)
    return simulate_mission(
        FLEET, tasks, scenario, Policy(min_dwell=0.0), lambda: 0.0, build_uniform_draw("1")
    )
