# SPDX-License-Identifier: Apache-2.0
"""Deviations of the model of the patrol from its run, taken apart: ``python -m tests.experiments.deviations [RUNS]``.

Recovery after a change of links, by which changes count and by what is known of pictures; pictures as they are read and as they
are counted; and ``local``, by what a picture and an idle host take in the run, with how long its starts take.
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from statistics import fmean
from typing import NamedTuple
from unittest.mock import patch

from edgectl.experiments import simulator
from edgectl.experiments.event_results import (
    Recovered,
    measure_sim_recoveries,
    measure_trial_recoveries,
    summarize_kinds,
)
from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.model.comparison import RecoveryResult
from edgectl.experiments.model.experiment import ExperimentRun
from edgectl.experiments.model.scenario import Scenario, SimRun
from edgectl.experiments.recovery import Points
from edgectl.experiments.scheme_results import summarize_trials
from edgectl.experiments.simulator_events import show_reading
from edgectl.experiments.simulator_state import SimState
from tests.docs.tables import render_table
from tests.experiments.edge_pictures import MOVED, RATE, render_edges
from tests.experiments.whereabouts import RUN, TASK, observe, simulate_patrol

ROBOTS = ("robot1", "robot2", "robot3")
# s between two plans.
EVERY_S = 2.0
ROBOT_CORES = 0.15
# Of the model, as the table of the page has it.
RUNS = 20


def find_link_recovery(found: Sequence[Recovered], *, first: bool) -> RecoveryResult:
    """Of the changes of links; ``first``: with those at the begin of the mission, before which no task runs."""
    chosen = [[pair for pair in each if first or pair[0].at > 0] for each in found]
    return summarize_kinds(chosen)["link"]


def measure_recoveries(run: ExperimentRun, scheme: str) -> list[Recovered]:
    """Of the trials of one scheme."""
    return [measure_trial_recoveries(run.experiment, each) for each in run.trials if each.scheme == scheme]


class ModelRecoveries(NamedTuple):
    """Of the same runs of the model: by speed, as the table of the page; by pictures/s, where any other task counts as 1, as in
    the run; and by pictures/s that hold from one reading to the next, as in the run.
    """

    speed: list[Recovered]
    pictures: list[Recovered]
    readings: list[Recovered]


def simulate_recoveries(scheme: str, runs: int) -> ModelRecoveries:
    """One of each for each seed."""
    found = ModelRecoveries([], [], [])
    for seed in range(runs):
        with note_readings() as readings:
            (run,) = simulate_patrol(scheme, [seed])
        counted = {name: _count_pictures(name, points) for name, points in run.courses.items()}
        held = {name: hold_readings(points, readings) for name, points in counted.items()}
        for courses, into in zip((run.courses, counted, held), found, strict=True):
            into.append(measure_sim_recoveries(replace(run, courses=courses), EVERY_S))
    return found


def _count_pictures(name: str, points: Points) -> tuple[tuple[float, float | None], ...]:
    rated = name.startswith(TASK)
    return tuple((at, None if speed is None else RATE * speed if rated else 1.0) for at, speed in points)


def hold_readings(points: Points, readings: Sequence[float]) -> tuple[tuple[float, float | None], ...]:
    """A course as it is known from readings: a value holds until the next one, 1 before the first. That a task does not
    run (None) is known at once.
    """
    value, held, found = None, 1.0, list[tuple[float, float | None]]()
    values = dict(points)
    for at in sorted({*values, *(at for at in readings if points and at > points[0][0])}):
        value = values.get(at, value)
        if at in readings and value is not None:
            held = value
        found.append((at, None if value is None else held))
    return tuple(found)


@contextmanager
def note_readings() -> Iterator[list[float]]:
    """Within, the moments at which the manager has read the fleet."""
    found = list[float]()

    def note(state: SimState) -> None:
        found.append(state.env.now)
        show_reading(state)

    with patch.object(simulator, "show_reading", note):
        yield found


@dataclass(slots=True)
class DetectionCourse:
    """By robot and run: when its detection begins and ends (s), all of its pictures, those and scans per second between, CPU (s) of
    the robot in the mission, and the time of the mission (s).
    """

    begin: list[float] = field(default_factory=list)
    end: list[float] = field(default_factory=list)
    made: list[float] = field(default_factory=list)
    pictures: list[float] = field(default_factory=list)
    scans: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)
    mission: list[float] = field(default_factory=list)


def measure_course(run: ExperimentRun, scheme: str) -> DetectionCourse:
    """That of the trials of one scheme."""
    found = DetectionCourse()
    for trial in run.trials:
        for robot in ROBOTS if trial.scheme == scheme else ():
            begin = min(span.start for span in trial.spans if span.task == TASK + robot)
            last = trial.readings["latency/values"][TASK + robot][-1]
            found.begin.append(begin)
            found.end.append(trial.completed[TASK + robot])
            found.made.append(last.value)
            found.pictures.append(last.value / (last.at - begin))
            found.scans.append(fmean(each.value for each in trial.readings["scans"][f"mapper-{robot}"]))
            found.cpu_s.append(trial.usage[robot].cpu_s)
            found.mission.append(trial.latency)
    return found


def measure_idle_cores(run: ExperimentRun) -> float:
    """Of an edge on which nothing runs: of edge2 and edge3 under ``local``."""
    idle = [trial for trial in run.trials if trial.scheme == "local"]
    return fmean(trial.usage[edge].cpu_s / trial.latency for trial in idle for edge in ("edge2", "edge3"))


def measure_picture_s(run: ExperimentRun) -> float:
    """CPU (s) of looking at a picture on its robot: what robots use more under ``local`` than under ``static``, which runs the same
    on them but detection, for each picture.
    """
    idle, (here, there) = measure_idle_cores(run), (measure_course(run, each) for each in ("local", "static"))
    used = [fmean(each.cpu_s) - idle * fmean(each.mission) for each in (here, there)]
    return (used[0] - used[1]) / fmean(here.made)


def simulate_course(
    scheme: str = "local", runs: int = 1, *, picture_s: float | None = None, idle: float | None = None
) -> DetectionCourse:
    """That of so many runs of the model, which has no spread under ``local``."""
    found = DetectionCourse()
    for seed in range(runs):
        made, began = dict[str, float](), dict[str, float]()
        with observe(partial(_count_items, made, began)):
            (run,) = simulate_patrol(
                scheme, [seed], lambda scenario: change_costs(scenario, picture_s=picture_s, idle=idle)
            )
        _add_run(found, run, made, began)
    return found


def _count_items(made: dict[str, float], began: dict[str, float], state: SimState, seconds: float) -> None:
    for name, service in state.services.items():
        if state.left.get(name):
            began.setdefault(name, service.since)
            made[name] = made.get(name, 0.0) + seconds * RATE * state.speeds.get(name, 0.0)


def _add_run(found: DetectionCourse, run: SimRun, made: dict[str, float], began: dict[str, float]) -> None:
    for robot in ROBOTS:
        begin = began[TASK + robot]
        found.begin.append(begin)
        found.end.append(max(at for job, at in run.jobs.items() if job.endswith(robot)))
        found.made.append(made[TASK + robot])
        found.pictures.append(made[TASK + robot] / (run.jobs[f"look-3-{robot}"] - begin))
        found.scans.append(made[f"mapper-{robot}"] / (run.jobs[f"map-3-{robot}"] - begin))
        found.cpu_s.append(run.usage[robot].cpu * ROBOT_CORES * run.latency)
        found.mission.append(run.latency)


def change_costs(
    scenario: Scenario, *, picture_s: float | None = None, idle: float | None = None
) -> Scenario:
    """The scenario with these CPU seconds for looking at a picture, and these cores of a host without tasks."""
    cycles = {
        name: replace(cycle, cpu=picture_s) if picture_s is not None and name.startswith(TASK) else cycle
        for name, cycle in scenario.cycles.items()
    }
    hosts = {
        name: host if idle is None else replace(host, base_cores=idle)
        for name, host in scenario.hosts.items()
    }
    return replace(scenario, cycles=cycles, hosts=hosts)


def render_recoveries(run: ExperimentRun, runs: int) -> str:
    """A row for each way to count, as docs/evaluation.md has it: means, and how many were not overcome."""
    measured = [measure_recoveries(run, scheme) for scheme in MOVED]
    model = [simulate_recoveries(scheme, runs) for scheme in MOVED]
    ways = [
        ("measured", measured, True),
        ("in the model", [each.speed for each in model], True),
        ("measured, without changes at the begin", measured, False),
        ("in the model, without these", [each.speed for each in model], False),
        ("in the model, so, by pictures/s", [each.pictures for each in model], False),
        ("in the model, so, by pictures/s that hold until the next reading", [each.readings for each in model], False),
    ]  # fmt: skip
    rows = [
        (name, *(_say_recovery(find_link_recovery(each, first=first)) for each in found))
        for name, found, first in ways
    ]
    return render_table(("recovery s after a change of links", *MOVED), rows)


def _say_recovery(found: RecoveryResult) -> str:
    known = found.recovery
    mean = "-" if known is None else f"{known.mean:.1f}±{known.half_ci95:.1f}"
    return f"{mean} ({found.not_recovered} of {found.count} not)"


def render_local(run: ExperimentRun) -> str:
    """`local`, measured and in the model, and with what a picture and an idle host take in the run."""
    picture_s, idle = measure_picture_s(run), measure_idle_cores(run)
    cost, rest = f"a picture takes {1000 * picture_s:.0f} ms", f"an idle host uses {idle:.3f} cores"
    models = [
        ("measured", measure_course(run, "local")),
        ("in the model", simulate_course()),
        (f"in the model, {cost}", simulate_course(picture_s=picture_s)),
        (f"in the model, {rest}", simulate_course(idle=idle)),
        ("in the model, both", simulate_course(picture_s=picture_s, idle=idle)),
    ]
    heading = (
        "local",
        "detection begins s",
        "ends s",
        "pictures/s",
        "scans/s",
        "CPU s of a robot",
        "mission s",
    )
    rows = list[tuple[str, ...]]()
    for name, found in models:
        begin, end, cpu_s, mission = map(fmean, (found.begin, found.end, found.cpu_s, found.mission))
        rates = [f"{fmean(each):.2f}" for each in (found.pictures, found.scans)]
        rows.append((name, f"{begin:.1f}", f"{end:.1f}", *rates, f"{cpu_s:.1f}", f"{mission:.1f}"))
    return render_table(heading, rows)


def render_pictures(run: ExperimentRun, runs: int) -> str:
    """Pictures of each scheme: as the table of the page has them, from readings, and counted over the time from the first detection
    of a robot to the end of its last one.
    """
    heading = (
        "scheme",
        "pictures/s, readings",
        "counted",
        "in the model",
        "pictures of a robot",
        "in the model",
    )
    rows = list[tuple[str, ...]]()
    for result in summarize_trials(run):
        name, read = result.scheme.name, result.metrics["fps"]
        assert read is not None
        found = measure_course(run, name), simulate_course(name, 1 if name == "local" else runs)
        rates = [f"{fmean(each.pictures):.2f}" for each in found]
        rows.append((name, f"{read.mean:.2f}", *rates, *(f"{fmean(each.made):.0f}" for each in found)))
    return render_table(heading, rows)


def measure_starts(run: ExperimentRun, scheme: str) -> list[list[float]]:
    """Seconds from a reading to the start of a robot, from there to its detection, to its follower, and to the next reading, of all
    robots.
    """
    found: list[list[float]] = [[], [], [], []]
    for trial in run.trials:
        readings = sorted({load.at for loads in trial.loads.values() for load in loads})
        for robot in ROBOTS if trial.scheme == scheme else ():
            starts = [
                min(span.start for span in trial.spans if span.task == f"{name}-{robot}")
                for name in ("robot", "detection", "follower")
            ]
            before = max(at for at in readings if at <= starts[0])
            after = min(at for at in readings if at > starts[-1])
            for seconds, (since, until) in zip(found, pairwise([before, *starts, after]), strict=True):
                seconds.append(until - since)
    return found


def render_starts(run: ExperimentRun) -> str:
    """A row for each of two schemes: means, and their sum."""
    heading = ("s", "reading to robot", "to detection", "to follower", "to next reading", "together")
    rows = list[tuple[str, ...]]()
    known = {trial.scheme for trial in run.trials}
    for scheme in (each for each in ("local", "static") if each in known):
        means = [fmean(each) for each in measure_starts(run, scheme)]
        rows.append((scheme, *(f"{each:.1f}" for each in (*means, sum(means)))))
    return render_table(heading, rows)


def main(runs: int) -> None:
    """Print the tables."""
    run = load_run(RUN)
    print(render_recoveries(run, runs))
    print(render_pictures(run, runs))
    print(render_edges(run, runs))
    print(render_local(run))
    print(render_starts(run))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS)
