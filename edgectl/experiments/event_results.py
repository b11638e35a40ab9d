# SPDX-License-Identifier: Apache-2.0
"""Events of simulated runs and of trials: how often they happened, and how long recovery took (ADR 133)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from edgectl.experiments.model.comparison import EventResult, RecoveryResult, SchemeResult
from edgectl.experiments.model.experiment import (
    Experiment,
    ExperimentRun,
    PlacementInterval,
    RecoveryMetric,
    Trial,
)
from edgectl.experiments.model.mission_event import EventRecord
from edgectl.experiments.model.scenario import SimRun
from edgectl.experiments.recovery import Course, Points, RecoveryRule, compute_recoveries
from edgectl.experiments.scheme_results import compute_usable_mean, estimate_usable_values

# A disturbance that the scheduler answers may come as late as its next plan.
_STEADY_PLANS = 2.0
Recovered = Sequence[tuple[EventRecord, float | None]]


def add_trial_events(run: ExperimentRun, results: Iterable[SchemeResult]) -> list[SchemeResult]:
    """``results`` of the schemes of ``run`` with its events."""
    found = []
    for result in results:
        trials = (trial for trial in run.trials if trial.scheme == result.scheme.name)
        recovered = [measure_trial_recoveries(run.experiment, trial) for trial in trials]
        found.append(
            replace(result, events=summarize_events(recovered), recoveries=summarize_kinds(recovered))
        )
    return found


def measure_sim_recoveries(run: SimRun, every: float) -> Recovered:
    """The events of a run, each with its recovery in s; None: not recovered. A task does well by speed.

    Tasks without a job have none, and do not count.
    """
    courses = {
        name: Course(points, run.course_ends.get(name, run.latency))
        for name, points in run.courses.items()
        if points
    }
    begun = [tuple(name for name in record.tasks if name in courses) for record in run.events]
    return _measure_recoveries(run.events, begun, courses, run.latency, _build_rule(every, RecoveryMetric()))


def measure_trial_recoveries(experiment: Experiment, trial: Trial) -> Recovered:
    """The events of a trial, each with its recovery in s; None: not recovered.

    A task does well by the metric of the experiment; without one it does where it runs.
    """
    end = max(chain([trial.latency], (span.end for span in trial.spans)))
    metric = experiment.recovery
    spans: dict[str, list[PlacementInterval]] = {}
    for span in trial.spans:
        spans.setdefault(span.task, []).append(span)
    readings = {} if metric is None else trial.readings.get(metric.metric, {})
    courses = {
        task: Course(
            _build_points(found, [(reading.at, reading.value) for reading in readings.get(task, ())]),
            trial.completed.get(task, end),
        )
        for task, found in spans.items()
    }
    rule = _build_rule(experiment.every, metric or RecoveryMetric(higher=False))
    return _measure_recoveries(trial.events, [record.tasks for record in trial.events], courses, end, rule)


def _build_rule(every: float, metric: RecoveryMetric) -> RecoveryRule:
    return RecoveryRule(
        window=metric.window,
        steady=max(metric.window, _STEADY_PLANS * every),
        within=metric.within,
        higher=metric.higher,
    )


def _measure_recoveries(
    records: Sequence[EventRecord],
    begun: Iterable[tuple[str, ...]],
    courses: Mapping[str, Course],
    end: float,
    rule: RecoveryRule,
) -> Recovered:
    """``begun``: for each record, the tasks that have to run."""
    events = [(record.at, tasks) for record, tasks in zip(records, begun, strict=True)]
    return list(zip(records, compute_recoveries(courses, events, end, rule), strict=True))


def _build_points(spans: Iterable[PlacementInterval], readings: Sequence[tuple[float, float]]) -> Points:
    """The course of a task: a reading holds until the next one, 1 before the first; None while none runs."""
    edges = sorted({moment for span in spans for moment in (span.start, span.end)})
    ordered = sorted((span.start, span.end) for span in spans)
    points = []
    for at in sorted({*edges, *(moment for moment, _ in readings if edges and moment >= edges[0])}):
        running = any(start <= at < end for start, end in ordered)
        known = [value for moment, value in readings if moment <= at]
        points.append((at, None if not running else known[-1] if known else 1.0))
    return points


def summarize_kinds(runs: Sequence[Recovered]) -> dict[str, RecoveryResult]:
    """By kind of event, over all runs of a scheme."""
    return {kind: _summarize_recoveries(found) for kind, found in _group_runs(runs, _get_kind).items()}


def summarize_events(runs: Sequence[Recovered]) -> tuple[EventResult, ...]:
    """By event, over all runs of a scheme."""
    return tuple(_summarize_event(found) for found in _group_runs(runs, _get_event).values())


def _get_kind(record: EventRecord) -> str:
    return record.kind


def _get_event(record: EventRecord) -> str:
    return record.event


def _group_runs(
    runs: Sequence[Recovered], get_key: Callable[[EventRecord], str]
) -> dict[str, list[Recovered]]:
    """The occurrences by key, then by run in which there are any."""
    keys = dict.fromkeys(get_key(record) for run in runs for record, _ in run)
    grouped = {key: [[pair for pair in run if get_key(pair[0]) == key] for run in runs] for key in keys}
    return {key: [found for found in each if found] for key, each in grouped.items()}


def _summarize_recoveries(runs: Sequence[Recovered]) -> RecoveryResult:
    """Occurrences in one run are not independent, so that each run counts by its mean."""
    means = [compute_usable_mean(recovery for _, recovery in run) for run in runs]
    return RecoveryResult(
        count=sum(map(len, runs)),
        not_recovered=sum(recovery is None for run in runs for _, recovery in run),
        recovery=estimate_usable_values(means),
    )


def _summarize_event(runs: Sequence[Recovered]) -> EventResult:
    records = [record for run in runs for record, _ in run]
    return EventResult(
        event=records[0].event,
        kind=records[0].kind,
        subject=records[0].subject,
        runs=len(runs),
        failed=sum(bool(record.error) for record in records),
        at=estimate_usable_values(run[0][0].at for run in runs),
        recoveries=_summarize_recoveries(runs),
    )
