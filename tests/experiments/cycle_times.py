# SPDX-License-Identifier: Apache-2.0
"""Times between a reading and a move of the real mission: ``python -m tests.experiments.cycle_times [DIRECTORY ..]``.

Of the pilot trials and of the counted run, for ``timing:`` of docs/scenarios/patrol.yaml, which takes those of the pilot.
"""

import sys
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import NamedTuple

from edgectl.experiments.files.run_directory import load_run
from edgectl.experiments.model.experiment import ExperimentRun, HandoffRecord, Trial
from edgectl.model.snapshot import CapacitySource
from tests.docs.tables import render_table
from tests.experiments.whereabouts import RUN, TASK, list_areas

PILOT = Path(__file__).parent / "lab" / "pilot"
# s: so long before a reading its window began, and so long after its start a task may not fill it yet.
WINDOW_S, STARTED_S = 0.75, 1.0


class CycleTimes(NamedTuple):
    """Seconds from a reading to the first stop of its plan, from the end of a move to the next stop of the plan, from the end
    of the last one to the next reading; and from a reading to a link that it lets change.
    """

    first: list[float]
    next: list[float]
    rest: list[float]
    change: list[float]


def measure_cycles(run: ExperimentRun) -> CycleTimes:
    """Of all plans that only move tasks."""
    found = CycleTimes([], [], [], [])
    for trial in run.trials:
        readings = _list_readings(trial)
        for reading, following in pairwise(readings):
            moves = sorted(_list_moves(trial, reading, following))
            if not moves or len(moves) < sum(reading < each.start <= following for each in trial.spans):
                continue
            found.first.append(moves[0][0] - reading)
            found.next.extend(stop - ended for (_, ended), (stop, _) in pairwise(moves))
            found.rest.append(following - max(ended for _, ended in moves))
        changes = [each.at for each in trial.events if each.kind == "link" and each.at > 0]
        found.change.extend(at - max(each for each in readings if each <= at) for at in changes)
    return found


def _list_readings(trial: Trial) -> list[float]:
    return sorted({sample.at for samples in trial.loads.values() for sample in samples})


def _list_moves(trial: Trial, since: float, until: float) -> Iterator[tuple[float, float]]:
    """(stop, end) of each move between two readings."""
    for move in trial.handoffs:
        if since < move.at <= until:
            yield max(_list_ends(trial, move), default=move.at), move.at


def _list_ends(trial: Trial, move: HandoffRecord) -> Iterator[float]:
    for span in trial.spans:
        if span.task == move.task and span.host == move.source and span.end <= move.at:
            yield span.end


def count_burst_readings(run: ExperimentRun, scheme: str) -> tuple[int, int]:
    """Readings while detection is on a far link, and those of them that read its rate from the traffic."""
    windows = read = 0
    for trial in run.trials:
        for span in trial.spans if trial.scheme == scheme else ():
            robot = span.task.removeprefix(TASK)
            if robot == span.task or span.host == robot:
                continue
            links = trial.links.get(span.host, {}).get(robot, ())
            seen = {each.at for each in links if each.source is CapacitySource.TCP}
            areas = list(list_areas(run, trial, robot))
            for at in _list_readings(trial):
                begin = at - WINDOW_S
                near = [edge for since, edge in areas if since <= begin]
                changes = any(begin < since <= at for since, _ in areas)
                if span.start + STARTED_S < at < span.end and near and near[-1] != span.host and not changes:
                    windows += 1
                    read += at in seen
    return windows, read


def render_times(runs: Iterable[tuple[str, ExperimentRun]]) -> str:
    """A row for each run, as docs/evaluation.md has it: medians and, of plans, their number."""
    times_read = ("reading to first stop s", "end of a move to next stop s", "last end to next reading s")
    heading, rows = ("", *times_read, "plans", "reading to change of links s"), list[tuple[str, ...]]()
    for name, run in runs:
        found = measure_cycles(run)
        times = [f"{median(each):.2f}" for each in (found.first, found.next, found.rest)]
        rows.append((name, *times, str(len(found.first)), f"{median(found.change):.2f}"))
    return render_table(heading, rows)


def main(directories: list[Path]) -> None:
    """Print the table, and how often bursts were read."""
    runs = [(path.name, load_run(path)) for path in directories]
    print(render_times(runs))
    for name, run in runs:
        for scheme in run.experiment.schemes:
            windows, read = count_burst_readings(run, scheme.name)
            if windows:
                share = f"{100 * read / windows:.0f} %"
                print(f"{name}, {scheme.name}: {read} of {windows} windows read a far link in use, {share}")


if __name__ == "__main__":
    main([Path(each) for each in sys.argv[1:]] or [PILOT, RUN])
