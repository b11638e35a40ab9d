"""Make the record of a trial out of what a watch saw and did. Pure: instants come in, s on one clock that nobody sets meanwhile."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import TypeVar

from edgectl.model.cycle import Cycle
from edgectl.model.experiment import Handoff, Load, Reading, Span, Trial
from edgectl.model.plan import Action
from edgectl.model.progress import Progress, Stage
from edgectl.model.result import ActionResult, Outcome, Phase
from edgectl.model.snapshot import HostSample, Snapshot, TaskSample, TaskState

Place = tuple[str, str]  # task, host
Timed = TypeVar("Timed", Load, Reading, Handoff)


class Recorder:
    """What is known of a trial so far. ``until``: the tasks whose completion ends it; ``began``: of its first plan, s since 1970."""

    def __init__(self, until: Collection[str]) -> None:
        self.began: float | None = None
        self.completed: dict[str, float] = {}
        self.places: dict[str, str] = {}
        self._until = until
        self._unplaced = 0
        self._heard: list[tuple[float, Progress]] = []
        self._open: dict[Place, float] = {}
        self._spans: list[tuple[Place, float, float]] = []
        self._handoffs: list[Handoff] = []
        self._loads: dict[str, list[Load]] = {}
        self._readings: dict[str, dict[str, list[Reading]]] = {}
        self._told: set[str] = set()
        self._given_up: set[str] = set()

    @property
    def finished(self) -> bool:
        """Whether all of ``until`` has completed."""
        return self.completed.keys() >= set(self._until)

    @property
    def hopeless(self) -> bool:
        """Whether a task of ``until`` was given up, so that it will never complete by itself."""
        return bool(self._given_up & set(self._until))

    def hear(self, event: Progress, at: float) -> None:
        """A step of an action, as it happens. It counts after what the cycle had seen before it acted."""
        self._heard.append((at, event))

    def see(self, cycle: Cycle) -> None:
        """A cycle that is over."""
        if self.began is None and (cycle.plan is not None or cycle.error):
            self.began = cycle.plan.created_at if cycle.plan is not None else cycle.at
        if cycle.plan is not None:
            self._unplaced += cycle.plan.summary.get(Action.UNPLACED, 0)
        if cycle.snapshot is not None:
            self._sample(cycle.snapshot)
        for at, event in self._heard:
            self._act(event, at)
        self._heard.clear()

    def trial(self, scheme: str, repetition: int, *, limit: float, ended: float, ssim: dict[str, float]) -> Trial:
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
            spans=tuple(sorted(_spans(spans, began), key=lambda span: (span.start, span.task, span.end))),
            handoffs=tuple(_after(self._handoffs, began)),
            loads={host: tuple(_after(loads, began)) for host, loads in self._loads.items()},
            readings={
                name: {task: tuple(_after(found, began)) for task, found in tasks.items()} for name, tasks in sorted(self._readings.items())
            },
            ssim=ssim,
        )

    def _sample(self, snapshot: Snapshot) -> None:
        at = snapshot.taken_at
        for host, sample in snapshot.hosts.items():
            if not sample.ok:
                continue
            self._loads.setdefault(host, []).append(_load(sample, at))
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
        if found.instance not in self._told:
            for name, value in found.metrics.items():
                self._readings.setdefault(name, {}).setdefault(task, []).append(Reading(at=at, value=value))
        if found.state.alive:
            self._open.setdefault((task, host), min(found.started_at, at))
        else:
            self._told.add(found.instance)
            self._close((task, host), at)

    def _act(self, event: Progress, at: float) -> None:
        if event.stage is Stage.ACTION_END and event.result is not None:
            self._moved(event.result, at)
        if event.stage is not Stage.PHASE_END or event.ended is None or not event.ended.ok:
            return
        place = (event.task, event.ended.host)
        if event.ended.phase in (Phase.START, Phase.RESTORE):
            self._open.setdefault(place, at)
            self.places[event.task] = event.ended.host
        elif event.ended.phase is Phase.STOP:
            self._close(place, at)

    def _moved(self, result: ActionResult, at: float) -> None:
        if result.action is Action.MOVE and result.outcome is Outcome.DONE and result.previous_host and result.host:
            self._handoffs.append(
                Handoff(task=result.task, source=result.previous_host, target=result.host, at=at, downtime=result.downtime_s)
            )

    def _close(self, place: Place, at: float) -> None:
        since = self._open.pop(place, None)
        if since is not None:
            self._spans.append((place, min(since, at), at))


def _load(sample: HostSample, at: float) -> Load:
    return Load(
        at=at,
        cores=sample.cpu.used_cores if sample.cpu else 0.0,
        memory=sample.memory.used_bytes if sample.memory else 0.0,
        bytes_per_s=sum(link.used_bytes_per_s for link in sample.links.values()),
    )


def _spans(spans: Iterable[tuple[Place, float, float]], began: float) -> Iterable[Span]:
    for (task, host), since, until in spans:
        yield Span(task=task, host=host, start=max(0.0, since - began), end=max(0.0, until - began))


def _after(entries: Iterable[Timed], began: float) -> Iterable[Timed]:
    """The same, counted from ``began``."""
    return (replace(entry, at=max(0.0, entry.at - began)) for entry in entries)
