# SPDX-License-Identifier: Apache-2.0
"""The scenario of the shipped experiment has the numbers and the events of its mission."""

import math
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.experiments.files.experiment_file import load_experiment, load_experiment_paths
from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.files.scenario_file import load_scenario, load_scenario_paths
from edgectl.experiments.model.experiment import Experiment
from edgectl.experiments.model.scenario import Scenario
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks
from edgectl.units import parse_rate
from tests.experiments.cycle_times import PILOT, measure_cycles
from tests.experiments.lab import patrol
from tests.experiments.lab.patrol import PATROL, ROOT, follower, radio, world

SCENARIO = ROOT / "docs" / "scenarios" / "patrol.yaml"
ROBOTS = ("robot3", "robot2", "robot1")


def load_spec() -> Experiment:
    inventory_file, tasks_file = load_experiment_paths(PATROL / "experiment.yaml")
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, warnings = load_inventory_and_tasks(inventory_file, [tasks_file])
    assert warnings == ()
    return load_experiment(PATROL / "experiment.yaml", inventory, tasks)


def load_model() -> tuple[Inventory, Tasks, Scenario]:
    inventory_file, tasks_file = load_scenario_paths(SCENARIO)
    assert inventory_file is not None
    assert tasks_file is not None
    inventory, tasks, _ = load_inventory_and_tasks(inventory_file, [Path(tasks_file)])
    return inventory, tasks, load_scenario(SCENARIO, inventory, tasks)


def world_sight_s() -> float:
    """The age (s) of results from which on a robot drives more slowly than its follower may."""
    return patrol.robot.SIGHT / 1.5


def time_the_way(number: int) -> list[float]:
    """Seconds of each leg of a tour for a robot that always has new results, at the rate of its follower."""
    made, now, found = patrol.robot.Robot(number), 0.0, list[float]()
    made.moved = now
    for sense in made.senses.values():
        sense.seen = math.inf
    for goal in made.tour:
        began = now
        while math.hypot(goal[0] - made.x, goal[1] - made.y) > follower.NEAR:
            made.move(now)
            made.forward, made.turn = follower.steer([made.x, made.y, made.angle], list(goal), 1.5)
            made.told, now = now, now + 1 / follower.RATE
        made.move(now)
        made.forward = made.turn = 0.0
        found.append(now - began)
    return found


def find_near_edge(robot: str, visit: int) -> str:
    """The edge of the area in which a stop of the robot's tour lies."""
    x, _ = world.Plan().tour(int(robot[-1]))[3 * visit]
    return f"edge{1 + int(x / world.metres(world.WIDTH) * world.ROOMS)}"


def test_the_shipped_spec_is_good() -> None:
    spec = load_spec()
    assert [scheme.name for scheme in spec.schemes] == ["local", "static", "least-loaded", "utility all"]
    assert (PATROL / spec.maps["ssim"].truth).exists()


def test_links_follow_the_tours() -> None:
    """Each robot is near the edge of its area, in the experiment and in the model alike."""
    events = {event.name: event for event in load_spec().events}
    start = events["links"].run
    assert start is not None
    assert set(start.argv[2:]) == {f"{robot}={find_near_edge(robot, 0)}" for robot in ROBOTS}
    _, _, scenario = load_model()
    model = {event.name: event for event in scenario.events}
    for robot in ROBOTS:
        for visit in (1, 2):
            event = events[f"{robot}-area{visit + 1}"]
            near = find_near_edge(robot, visit)
            assert event.run is not None
            assert event.run.argv[2:] == (f"{robot}={near}",)
            assert event.when is not None
            assert event.when.progress is not None
            assert event.when.progress.reaches == pytest.approx(visit / 3, abs=0.01)
            link = model[f"{robot}-area{visit + 1}-{near}"].link
            assert link is not None
            assert (link.edge, link.robot) == (near, robot)
            assert link.throughput == parse_rate(f"{radio.NEAR.removesuffix('mbit')}Mbit/s")
            far = model[f"{robot}-area{visit + 1}-{find_near_edge(robot, visit - 1)}"].link
            assert far is not None
            assert far.throughput == parse_rate(f"{radio.FAR.removesuffix('mbit')}Mbit/s")


def test_the_models_inputs_are_the_missions_own() -> None:
    inventory, tasks, scenario = load_model()
    for name, host in scenario.hosts.items():
        capacity = inventory.hosts[name].capacity
        assert capacity is not None
        assert (host.cores, host.memory) == (capacity["cpu"], capacity["memory"])
    command = {name: task.command for name, task in tasks.tasks.items()}
    work = {job.name: job.work for job in scenario.jobs}
    for robot in ROBOTS:
        assert "--rate 5" in command[f"detection-{robot}"]
        assert "--rate 5" in command[f"mapper-{robot}"]
        assert len(world.Plan().tour(int(robot[-1]))) == 9
        for visit in (1, 2, 3):
            # The first result at a stop is of an item that was begun before, by half of its time.
            assert work[f"look-{visit}-{robot}"] == pytest.approx(3 * (follower.FRAMES - 0.5) / 5)
            assert work[f"map-{visit}-{robot}"] == pytest.approx(3 * (follower.SCANS - 0.5) / 5)
        for task in ("detection", "mapper"):
            assert scenario.cycles[f"{task}-{robot}"].rate == 5.0
        assert scenario.cycles[f"follower-{robot}"].rate == follower.RATE
    assert {job.fresh for job in scenario.jobs if job.senses} == {world_sight_s()}
    assert scenario.timing.paced
    assert scenario.timing.every == load_spec().every
    real = {event.name: event for event in load_spec().events}
    for event in scenario.events:
        if event.join is not None:
            assert (real[event.name].join, real[event.name].at) == (event.join, event.at)
    assert real["stranger"].at == next(event.at for event in scenario.events if event.name == "stranger")


def test_plans_of_the_model_take_as_long_as_those_of_the_pilot() -> None:
    """From a reading to the first stop, and from the end of a move to the next stop; links change with the reading."""
    _, _, scenario = load_model()
    pilot, timing = measure_cycles(load_run(PILOT)), scenario.timing
    assert timing.plan + timing.prepare == pytest.approx(median(pilot.first), abs=0.05)
    assert timing.prepare == pytest.approx(median(pilot.next), abs=0.05)
    assert timing.by_reading
    assert median(pilot.change) < 0.1


def test_robots_see_all_rooms_together() -> None:
    plan = world.Plan()
    seen = {stop for robot in ROBOTS for stop in plan.tour(int(robot[-1]))}
    assert seen == {point for stops in plan.stops for point in stops}
    for robot in ROBOTS:
        tour = plan.tour(int(robot[-1]))
        assert max(math.dist(one, other) for one, other in pairwise(tour)) < world.metres(world.WIDTH)


def test_the_way_of_the_model_is_that_of_the_robots() -> None:
    """5.7 s an area: a mean of the nine of three robots, of which the first begins where it stands."""
    _, _, scenario = load_model()
    work = {job.name: job.work for job in scenario.jobs}
    way = sum(work[f"{leg}-{visit}-robot1"] for leg in ("turn", "drive") for visit in (1, 2, 3))
    tours = [sum(time_the_way(number)) for number in (1, 2, 3)]
    assert way == pytest.approx(sum(tours) / 3, rel=0.05)
