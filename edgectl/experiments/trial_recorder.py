"""Make the record of a trial out of what a watch saw and did. Pure: instants come in, s on one clock that nobody sets meanwhile."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import TypeVar

from edgectl.experiments.model.experiment import (
    HandoffRecord,
    LoadSample,
    MetricReading,
    PlacementInterval,
    Trial,
)
from edgectl.model.cycle import Cycle
from edgectl.model.plan import Action
from edgectl.model.progress import ProgressEvent, ProgressStage
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState

TaskHostPair = tuple[str, str]  # task, host
Timed = TypeVar("Timed", LoadSample, MetricReading, HandoffRecord)


class TrialRecorder:
    """What is known of a trial so far. ``until``: the tasks whose completion ends it; ``began``: of its first plan, s since 1970."""

    def __init__(self, until: Collection[str]) -> None:
        self.began: float | None = None
        self.completed: dict[str, float] = {}
        self.places: dict[str, str] = {}
        self._until = until
        self._unplaced = 0
        self._heard: list[tuple[float, ProgressEvent]] = []
        self._open: dict[TaskHostPair, float] = {}
        self._spans: list[tuple[TaskHostPair, float, float]] = []
        self._handoffs: list[HandoffRecord] = []
        self._loads: dict[str, list[LoadSample]] = {}
        self._readings: dict[str, dict[str, list[MetricReading]]] = {}
        self._ended_instances: set[str] = set()
        self._given_up: set[str] = set()

    @property
    def finished(self) -> bool:
        """Whether all of ``until`` has completed."""
        return self.completed.keys() >= set(self._until)

    @property
    def has_given_up(self) -> bool:
        """Whether a task of ``until`` was given up, so that it will never complete by itself."""
        return bool(self._given_up & set(self._until))

    def record_progress(self, event: ProgressEvent, at: float) -> None:
        """A step of an action, as it happens. It counts after what the cycle had seen before it acted."""
        self._heard.append((at, event))

    def record_cycle(self, cycle: Cycle) -> None:
        """A cycle that is over."""
        if self.began is None and (cycle.plan is not None or cycle.error):
            self.began = cycle.plan.created_at if cycle.plan is not None else cycle.at
        if cycle.plan is not None:
            self._unplaced += cycle.plan.summary.get(Action.UNPLACED, 0)
        if cycle.snapshot is not None:
            self._sample(cycle.snapshot)
        for at, event in self._heard:
            self._record_phase(event, at)
        self._heard.clear()

    def build_trial(
        self, scheme: str, repetition: int, *, limit: float, ended: float, ssim: dict[str, float]
    ) -> Trial:
        """The record; what is still there is there until ``ended``."""
        began = ended if self.began is None else self.began
        spans = [*self._spans, *((place, since, ended) for place, since in self._open.items())]
        completed = {task: max(0.0, at - began) for task, at in self.completed.items()}
        return Trial(
            scheme=scheme,
            repetition=repetition,
            began_at=began,
            latency=max((completed[task] for task in self._until), default=0.0) if self.finished else limit,
            finished=self.finished,
            unplaced=self._unplaced,
            completed=completed,
            spans=tuple(
                sorted(_build_intervals(spans, began), key=lambda span: (span.start, span.task, span.end))
            ),
            handoffs=tuple(_rebase_on_trial_start(self._handoffs, began)),
            loads={host: tuple(_rebase_on_trial_start(loads, began)) for host, loads in self._loads.items()},
            readings={
                name: {task: tuple(_rebase_on_trial_start(found, began)) for task, found in tasks.items()}
                for name, tasks in sorted(self._readings.items())
            },
            ssim=ssim,
        )

    def _sample(self, snapshot: Snapshot) -> None:
        at = snapshot.taken_at
        for host, sample in snapshot.hosts.items():
            if not sample.ok:
                continue
            self._loads.setdefault(host, []).append(_build_load_sample(sample, at))
            for task, found in sample.tasks.items():
                if found.managed:
                    self._look(task, host, found, at)
            gone = [place for place in self._open if place[1] == host and place[0] not in sample.tasks]
            for place in gone:
                self._close(place, at)

    def _look(self, task: str, host: str, found: TaskSample, at: float) -> None:
        """One task on one host, as it was seen."""
        over = found.state is TaskState.COMPLETED
        at = at if found.ended_at is None else min(at, found.ended_at)
        if over and task not in self.completed:
            self.completed[task] = at
        if found.given_up:
            self._given_up.add(task)
        if found.state.alive or over:
            self.places[task] = host
        if found.instance not in self._ended_instances:
            for name, value in found.metrics.items():
                self._readings.setdefault(name, {}).setdefault(task, []).append(
                    MetricReading(at=at, value=value)
                )
        if found.state.alive:
            self._open.setdefault((task, host), min(found.started_at, at))
        else:
            self._ended_instances.add(found.instance)
            self._close((task, host), at)

    def _record_phase(self, event: ProgressEvent, at: float) -> None:
        if event.stage is ProgressStage.ACTION_END and event.result is not None:
            self._record_handoff(event.result, at)
        if event.stage is not ProgressStage.PHASE_END or event.ended is None or not event.ended.ok:
            return
        place = (event.task, event.ended.host)
        if event.ended.phase in (Phase.START, Phase.RESTORE):
            self._open.setdefault(place, at)
            self.places[event.task] = event.ended.host
        elif event.ended.phase is Phase.STOP:
            self._close(place, at)

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
                )
            )

    def _close(self, place: TaskHostPair, at: float) -> None:
        since = self._open.pop(place, None)
        if since is not None:
            self._spans.append((place, min(since, at), at))


def _build_load_sample(sample: HostSample, at: float) -> LoadSample:
    return LoadSample(
        at=at,
        cores=sample.cpu.used_cores if sample.cpu else 0.0,
        memory=sample.memory.used_bytes if sample.memory else 0.0,
        bytes_per_s=sum(link.used_bytes_per_s for link in sample.links.values()),
    )


def _build_intervals(
    spans: Iterable[tuple[TaskHostPair, float, float]], began: float
) -> Iterable[PlacementInterval]:
    for (task, host), since, until in spans:
        yield PlacementInterval(
            task=task, host=host, start=max(0.0, since - began), end=max(0.0, until - began)
        )


def _rebase_on_trial_start(entries: Iterable[Timed], began: float) -> Iterable[Timed]:
    """The same, counted from ``began``."""
    return (replace(entry, at=max(0.0, entry.at - began)) for entry in entries)
