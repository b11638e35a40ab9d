# SPDX-License-Identifier: Apache-2.0
"""Pictures that are looked at on each edge in a mission of the patrol, measured and in the model: they make the CPU of edges.

``python -m tests.experiments.deviations`` prints them.
"""

from collections.abc import Sequence
from functools import partial
from statistics import fmean
from typing import NamedTuple

from edgectl.experiments.model.experiment import ExperimentRun, PlacementInterval, Trial
from edgectl.experiments.simulator_state import SimState
from tests.docs.tables import render_table
from tests.experiments.whereabouts import EDGES, TASK, observe, simulate_patrol

# Pictures/s of a detection at full speed.
RATE = 5.0
CORES = {"edge1": 0.45, "edge2": 0.35, "edge3": 0.3}
MOVED = ("least-loaded", "utility all")


class EdgePictures(NamedTuple):
    """Of an edge, pictures of a mission; those among them of detections whose work is over; CPU (s)."""

    made: float
    late: float
    cpu_s: float


def measure_edges(run: ExperimentRun, scheme: str) -> dict[str, EdgePictures]:
    """By edge, means of the trials. Pictures are counted from one reading to the next; a move comes between two."""
    trials = [trial for trial in run.trials if trial.scheme == scheme]
    spans = [
        (span.host, _count_span(trial, span))
        for trial in trials
        for span in trial.spans
        if span.task.startswith(TASK)
    ]
    return {
        edge: EdgePictures(
            made=sum(made for host, made in spans if host == edge) / len(trials),
            late=0.0,
            cpu_s=fmean(trial.usage[edge].cpu_s for trial in trials),
        )
        for edge in EDGES
    }


def _count_span(trial: Trial, span: PlacementInterval) -> float:
    first = min(each.start for each in trial.spans if each.task == span.task)
    readings = trial.readings["latency/values"][span.task]
    points = [(first, 0.0), *((each.at, each.value) for each in readings if each.at > first)]
    return read_counter(points, span.end) - read_counter(points, span.start)


def read_counter(points: Sequence[tuple[float, float]], at: float) -> float:
    """What a counter has counted, linear between its readings (s, count)."""
    before = points[0]
    for moment, value in points:
        if moment >= at:
            seconds = moment - before[0]
            return before[1] + (value - before[1]) * ((at - before[0]) / seconds if seconds > 0 else 1.0)
        before = moment, value
    return before[1]


def simulate_edges(scheme: str, runs: int) -> dict[str, EdgePictures]:
    """The same of so many runs of the model."""
    made, late = dict.fromkeys(EDGES, 0.0), dict.fromkeys(EDGES, 0.0)
    with observe(partial(_count, made, late)):
        found = simulate_patrol(scheme, range(runs))
    return {
        edge: EdgePictures(
            made[edge] / runs, late[edge] / runs, fmean(each.usage[edge].cpu * CORES[edge] * each.latency for each in found)
        )
        for edge in EDGES
    }  # fmt: skip


def _count(made: dict[str, float], late: dict[str, float], state: SimState, seconds: float) -> None:
    for name, service in state.services.items():
        if name.startswith(TASK) and service.host in made:
            pictures = seconds * RATE * state.speeds.get(name, 0.0)
            made[service.host] += pictures
            late[service.host] += pictures * (not state.left[name])


def render_edges(run: ExperimentRun, runs: int) -> str:
    """A row for each of the schemes that move, and each edge."""
    heading = ("edge", "pictures", "in the model", "of these after the work", "CPU s", "in the model")
    rows = list[tuple[str, ...]]()
    for scheme in MOVED:
        real, model = measure_edges(run, scheme), simulate_edges(scheme, runs)
        for edge in EDGES:
            counts = (f"{each:.0f}" for each in (real[edge].made, model[edge].made, model[edge].late))
            seconds = (f"{each.cpu_s:.1f}" for each in (real[edge], model[edge]))
            rows.append((f"{scheme}, {edge}", *counts, *seconds))
    return render_table(heading, rows)
