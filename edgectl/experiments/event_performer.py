# SPDX-License-Identifier: Apache-2.0
"""Events of a trial on real hosts: each waits for its moment in a thread, acts, and is undone in the end."""

import threading
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from typing import Self

from edgectl.errors import EdgectlError
from edgectl.experiments.event_actions import EventMeans, begin_change, end_change
from edgectl.experiments.held_changes import save_held_changes
from edgectl.experiments.model.mission_event import (
    EventCommand,
    EventCondition,
    EventRecord,
    MissionEvent,
    begin_record,
)
from edgectl.model.snapshot import Snapshot, TaskState

# Name of the application metric in which a task that serves a robot says how much of its mission is done.
PROGRESS_METRIC = "progress"


class EventPerformer:
    """The events of one trial.

    ``means.fleet`` is that of the trial, with all tasks. ``draw_uniform``: from 0 to 1, a stream by event.
    ``until``: tasks whose completion ends the mission, after which no condition holds any more.
    """

    def __init__(
        self,
        events: Iterable[MissionEvent],
        means: EventMeans,
        draw_uniform: Callable[[str], float],
        *,
        until: Collection[str],
    ) -> None:
        self._events, self._means, self._draw_uniform = tuple(events), means, draw_uniform
        self._until = until
        self._changed = threading.Condition()
        self._began: float | None = None
        self._happened: set[str] = set()
        self._held: dict[str, MissionEvent] = {}
        self._stuck: list[EventCommand] = []
        self._records: list[EventRecord] = []
        self._completed: set[str] = set()
        self._placed: set[str] = set()
        self._progress: dict[str, float] = {}
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> Self:
        """Perform what comes before the first plan."""
        for event in self._events:
            if event.at == 0.0 and not event.jitter:
                self._begin(event)
        return self

    def __exit__(self, *exc: object) -> None:
        self.finish()

    @property
    def happened(self) -> frozenset[str]:
        """Names of the events that have happened so far."""
        with self._changed:
            return frozenset(self._happened)

    def begin_mission(self) -> None:
        """Count the times of events from now on; later calls do nothing."""
        if self._began is not None:
            return
        self._began = self._means.fleet.clock()
        for event in self._events:
            thread = threading.Thread(target=self._run_event, args=(event,), name=f"event {event.name}")
            self._threads.append(thread)
            thread.start()

    def see_snapshot(self, snapshot: Snapshot) -> None:
        """Take in what a sample shows: tasks that run or have completed, and the progress of robots."""
        tasks = self._means.fleet.tasks.tasks
        with self._changed:
            self._placed = set()
            for host in snapshot.hosts.values():
                for name, sample in host.tasks.items():
                    if sample.state is TaskState.COMPLETED:
                        self._completed.add(name)
                    if sample.state.alive:
                        self._placed.add(name)
                    done = sample.metrics.get(PROGRESS_METRIC)
                    for robot in tasks[name].robots if name in tasks and done is not None else ():
                        self._progress[robot] = max(self._progress.get(robot, 0.0), done or 0.0)
            if not self._completed.issuperset(self._until):
                self._changed.notify_all()

    def finish(self) -> tuple[EventRecord, ...]:
        """End all waits, undo what still holds, the last first; what happened, by the fleet's clock."""
        with self._changed:
            self._means.ended.set()
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()
        for name in reversed(list(self._held)):
            self._end(self._held[name])
        return tuple(sorted(self._records, key=lambda record: record.at))

    def _run_event(self, event: MissionEvent) -> None:
        """Wait for the first occurrence, then make and undo the change as often as stated."""
        assert self._began is not None  # noqa: S101 - begun before its threads
        condition = event.when
        if condition is not None and not self._wait_until(lambda: self._holds(condition)):
            return
        due = self._means.fleet.clock() if event.at is None else self._began + event.at
        number = 0
        while event.occurrences is None or number < event.occurrences:
            late = event.jitter * self._draw_uniform(event.name) if event.jitter else 0.0
            if number or event.name not in self._happened:
                if not self._sleep_until(due + late):
                    return
                self._begin(event)
            if event.duration is not None:
                if not self._sleep_until(due + late + event.duration):
                    return
                self._end(event)
            number += 1
            due += event.every or 0.0

    def _begin(self, event: MissionEvent) -> None:
        record = begin_record(event, self._means.fleet.clock(), self._means.fleet.tasks)
        with self._changed:
            self._held.pop(event.name, None)  # of a repetition the place is the last one
            self._held[event.name] = event
            error = self._save()
            if error:
                del self._held[event.name]
        error = error or self._act(begin_change, event)
        with self._changed:
            self._records.append(replace(record, error=error))
            self._happened.add(event.name)
        if error:
            self._means.fleet.warn(f"event {event.name}: {error}")

    def _end(self, event: MissionEvent) -> None:
        """Undo the change; where that fails, the record of the trial keeps it for another try."""
        if event.name not in self._held:
            return
        error = self._act(end_change, event)
        with self._changed:
            index = max(i for i, record in enumerate(self._records) if record.event == event.name)
            record = self._records[index]
            until = self._means.fleet.clock() if event.run is not None and event.run.undo else None
            told = "; ".join(filter(None, (record.error, f"not undone: {error}" if error else "")))
            self._records[index] = replace(record, until=None if error else until, error=told)
            del self._held[event.name]
            if error and event.run is not None:
                self._stuck.append(event.run)
            self._save()
        if error:
            self._means.fleet.warn(f"event {event.name} is not undone: {error}")

    def _save(self) -> str:
        """Record what has to be undone; why the disk does not take it, "" where it does."""
        held = [*self._stuck, *(event.run for event in self._held.values() if event.run is not None)]
        try:
            save_held_changes(self._means.fleet, held)
        except EdgectlError as error:
            return error.message
        return ""

    def _act(self, act: Callable[[EventMeans, MissionEvent], str], event: MissionEvent) -> str:
        try:
            return act(self._means, event)
        except EdgectlError as error:
            return error.message
        except OSError as error:
            return str(error)

    def _holds(self, condition: EventCondition) -> bool:
        progress = condition.progress
        return (
            self._completed.issuperset(condition.completed)
            and self._placed.issuperset(condition.placed)
            and (progress is None or self._progress.get(progress.robot, 0.0) >= progress.reaches)
        )

    def _wait_until(self, holds: Callable[[], bool]) -> bool:
        """Whether ``holds`` came true before the trial ended."""
        with self._changed:
            self._changed.wait_for(lambda: holds() or self._means.ended.is_set())
            return holds() and not self._means.ended.is_set()

    def _sleep_until(self, moment: float) -> bool:
        """Whether the trial still goes on at ``moment``."""
        return not self._means.ended.wait(max(0.0, moment - self._means.fleet.clock()))
