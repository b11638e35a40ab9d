# SPDX-License-Identifier: Apache-2.0
"""Record of a trial, built from the cycles and progress events of a watch (pure).

All instants are seconds on one monotonic clock.
"""

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import TypeVar

from edgectl.experiments.mission_usage import UsageCounters
from edgectl.experiments.model.experiment import (
    HandoffRecord,
    LinkCapacity,
    LoadSample,
    MetricReading,
    PlacementInterval,
    Trial,
)
from edgectl.experiments.model.mission_event import EventRecord
from edgectl.model.cycle import Cycle
from edgectl.model.latency import LatencySample, list_latency_readings, merge_latencies
from edgectl.model.plan import Action
from edgectl.model.progress import ProgressEvent, ProgressStage
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState

TaskHostPair = tuple[str, str]  # task, host
Timed = TypeVar("Timed", LoadSample, LinkCapacity, MetricReading, HandoffRecord, EventRecord)


class TrialRecorder:
    """A trial so far. ``until``: the tasks whose completion ends it.

    ``began``: time of the first plan (s since 1970). ``completed``: by task, time of completion.
    ``places``: by task, the host that it was last seen on.
    """

    def __init__(self, until: Collection[str]) -> None:
        self.began: float | None = None
        self.completed: dict[str, float] = {}
        self.places: dict[str, str] = {}
        self._until = until
        self._unplaced = 0
        self._pending_events: list[tuple[float, ProgressEvent]] = []
        self._open_intervals: dict[TaskHostPair, float] = {}
        self._intervals: list[tuple[TaskHostPair, float, float]] = []
        self._handoffs: list[HandoffRecord] = []
        self._loads: dict[str, list[LoadSample]] = {}
        self._links: dict[str, dict[str, list[LinkCapacity]]] = {}
        self._readings: dict[str, dict[str, list[MetricReading]]] = {}
        self._latencies: dict[str, dict[str, LatencySample]] = {}
        self._ended_instances: set[str] = set()
        self._given_up: set[str] = set()
        self._counters = UsageCounters()

    @property
    def finished(self) -> bool:
        """Whether all tasks of ``until`` have completed."""
        return self.completed.keys() >= set(self._until)

    @property
    def has_given_up(self) -> bool:
        """Whether a task of ``until`` has failed for good, so that it cannot complete."""
        return bool(self._given_up & set(self._until))

    def record_progress(self, event: ProgressEvent, at: float) -> None:
        """Keep a progress event until its cycle ends: it happened after the snapshot of that cycle."""
        self._pending_events.append((at, event))

    def record_cycle(self, cycle: Cycle) -> None:
        """Record the snapshot of a finished cycle, then its progress events."""
        if self.began is None and (cycle.plan is not None or cycle.error):
            self.began = cycle.plan.created_at if cycle.plan is not None else cycle.at
        if cycle.plan is not None:
            self._unplaced += cycle.plan.summary.get(Action.UNPLACED, 0)
        if cycle.snapshot is not None:
            self._counters.record_snapshot(cycle.snapshot)
            self._record_snapshot(cycle.snapshot)
        for at, event in self._pending_events:
            self._record_phase(event, at)
        self._pending_events.clear()

    def record_closing(self, snapshot: Snapshot) -> None:
        """Record the counters of hosts after the mission: what they use without it."""
        self._counters.record_snapshot(snapshot)

    def build_trial(
        self,
        scheme: str,
        repetition: int,
        *,
        limit: float,
        ended: float,
        ssim: dict[str, float],
        events: Iterable[EventRecord] = (),
    ) -> Trial:
        """The trial; intervals that are still open end at ``ended``."""
        began = ended if self.began is None else self.began
        intervals = [
            *self._intervals,
            *((place, since, ended) for place, since in self._open_intervals.items()),
        ]
        completed = {task: max(0.0, at - began) for task, at in self.completed.items()}
        latency = max((completed[task] for task in self._until), default=0.0) if self.finished else limit
        over = began + latency if self.finished else ended
        return Trial(
            scheme=scheme,
            repetition=repetition,
            began_at=began,
            latency=latency,
            finished=self.finished,
            unplaced=self._unplaced,
            completed=completed,
            spans=tuple(
                sorted(_build_intervals(intervals, began), key=lambda span: (span.start, span.task, span.end))
            ),
            handoffs=tuple(_rebase_on_trial_start(self._handoffs, began)),
            loads={host: tuple(_rebase_on_trial_start(loads, began)) for host, loads in self._loads.items()},
            readings={
                name: {task: tuple(_rebase_on_trial_start(found, began)) for task, found in tasks.items()}
                for name, tasks in sorted(self._readings.items())
            },
            ssim=ssim,
            links={
                edge: {robot: tuple(_rebase_on_trial_start(found, began)) for robot, found in links.items()}
                for edge, links in self._links.items()
            },
            usage=self._counters.compute_usage(began, over),
            events=tuple(_rebase_events(events, began)),
        )

    def _record_snapshot(self, snapshot: Snapshot) -> None:
        at = snapshot.taken_at
        for host, host_sample in snapshot.hosts.items():
            if not host_sample.ok:
                continue
            self._loads.setdefault(host, []).append(_build_load_sample(host_sample, at))
            self._record_links(host, host_sample, at)
            for task, sample in host_sample.tasks.items():
                if sample.managed:
                    self._record_task(task, host, sample, at)
            gone = [
                place
                for place in self._open_intervals
                if place[1] == host and place[0] not in host_sample.tasks
            ]
            for place in gone:
                self._close_interval(place, at)

    def _record_links(self, edge: str, sample: HostSample, at: float) -> None:
        """Record what its links carry, where that changed."""
        for robot, link in sample.links.items():
            found = self._links.setdefault(edge, {}).setdefault(robot, [])
            now = LinkCapacity(at=at, bytes_per_s=link.capacity_bytes_per_s, source=link.capacity_source)
            if not found or replace(found[-1], at=at) != now:
                found.append(now)

    def _record_task(self, task: str, host: str, sample: TaskSample, at: float) -> None:
        """Record one task on one host."""
        completed = sample.state is TaskState.COMPLETED
        at = at if sample.ended_at is None else min(at, sample.ended_at)
        if completed and task not in self.completed:
            self.completed[task] = at
        if sample.given_up:
            self._given_up.add(task)
        if sample.state.alive or completed:
            self.places[task] = host
        if sample.instance not in self._ended_instances:
            for name, value in [*sample.metrics.items(), *self._merge_latency(task, sample)]:
                self._readings.setdefault(name, {}).setdefault(task, []).append(
                    MetricReading(at=at, value=value)
                )
        if sample.state.alive:
            self._open_intervals.setdefault((task, host), min(sample.started_at, at))
        else:
            self._ended_instances.add(sample.instance)
            self._close_interval((task, host), at)

    def _merge_latency(self, task: str, sample: TaskSample) -> list[tuple[str, float]]:
        """The latency of a task over the whole trial: the counts of all its instances so far."""
        if sample.latency is None or not sample.latency.count:
            return []
        instances = self._latencies.setdefault(task, {})
        instances[sample.instance] = sample.latency
        return list_latency_readings(merge_latencies(instances.values()))

    def _record_phase(self, event: ProgressEvent, at: float) -> None:
        if event.stage is ProgressStage.ACTION_END and event.result is not None:
            self._record_handoff(event.result, at)
        if event.stage is not ProgressStage.PHASE_END or event.ended is None or not event.ended.ok:
            return
        place = (event.task, event.ended.host)
        if event.ended.phase in (Phase.START, Phase.RESTORE):
            self._open_intervals.setdefault(place, at)
            self.places[event.task] = event.ended.host
        elif event.ended.phase is Phase.STOP:
            self._close_interval(place, at)

    def _record_handoff(self, result: ActionResult, at: float) -> None:
        if (
            result.action is Action.MOVE
            and result.outcome is Outcome.DONE
            and result.previous_host
            and result.host
        ):
            self._handoffs.append(
                HandoffRecord(
                    task=result.task,
                    source=result.previous_host,
                    target=result.host,
                    at=at,
                    downtime=result.downtime_s,
                    gap=result.gap_s,
                )
            )

    def _close_interval(self, place: TaskHostPair, at: float) -> None:
        since = self._open_intervals.pop(place, None)
        if since is not None:
            self._intervals.append((place, min(since, at), at))


def _build_load_sample(sample: HostSample, at: float) -> LoadSample:
    return LoadSample(
        at=at,
        cores=sample.usage["cpu"].used if "cpu" in sample.usage else 0.0,
        memory=sample.usage["memory"].used if "memory" in sample.usage else 0.0,
        bytes_per_s=sum(link.used_bytes_per_s for link in sample.links.values()),
    )


def _build_intervals(
    intervals: Iterable[tuple[TaskHostPair, float, float]], began: float
) -> Iterable[PlacementInterval]:
    for (task, host), since, until in intervals:
        yield PlacementInterval(
            task=task, host=host, start=max(0.0, since - began), end=max(0.0, until - began)
        )


def _rebase_on_trial_start(entries: Iterable[Timed], began: float) -> Iterable[Timed]:
    """The entries with times counted from ``began``."""
    return (replace(entry, at=max(0.0, entry.at - began)) for entry in entries)


def _rebase_events(records: Iterable[EventRecord], began: float) -> Iterable[EventRecord]:
    for record in _rebase_on_trial_start(records, began):
        yield replace(record, until=None if record.until is None else max(0.0, record.until - began))
