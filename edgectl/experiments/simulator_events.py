# SPDX-License-Identifier: Apache-2.0
"""Events of a simulated mission: what starts and ends them, and how they change the model."""

from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import replace
from typing import Any

import simpy

from edgectl.experiments.model.mission_event import (
    EventCondition,
    MissionEvent,
    RobotProgress,
    begin_record,
    select_present_tasks,
)
from edgectl.experiments.simulator_flows import get_job_speed
from edgectl.experiments.simulator_speeds import update_speeds
from edgectl.experiments.simulator_state import (
    Overlay,
    SimState,
    SimTask,
    integrate_loads,
    list_external_placements,
)

# Work (s) below which a share of the mission counts as reached.
_WORK_TOLERANCE_S = 1e-9


def start_events(state: SimState) -> None:
    """Start a process for each event, after those of the jobs and before the first plan."""
    for event in state.scenario.events:
        state.env.process(_run_event(state, event))


def _run_event(state: SimState, event: MissionEvent) -> Generator[Any, Any, None]:
    """Wait for the first occurrence, then make and undo the change as often as stated."""
    if event.when is not None:
        yield from _wait_for_condition(state, event.when)
    due = state.env.now if event.at is None else event.at
    number = 0
    while event.occurrences is None or number < event.occurrences:
        late = event.jitter * state.draw_uniform(event.name) if event.jitter else 0.0
        if due + late > state.env.now:
            yield state.env.timeout(due + late - state.env.now)
        record = _begin_change(state, event)
        if event.duration is not None:
            yield state.env.timeout(event.duration)
            _end_change(state, event, record)
        number += 1
        due += event.every or 0.0


def _begin_change(state: SimState, event: MissionEvent) -> int:
    """Make the change; the index of its record."""
    integrate_loads(state)
    # One that is repeated without an end begins anew, so that it is the latest.
    others = {name: other for name, other in state.happening.items() if name != event.name}
    state.happening = {**others, event.name: event}
    state.happened.add(event.name)
    state.overlay = _build_overlay(state)
    record = begin_record(event, state.env.now, state.all_tasks)
    state.records.append(record)
    for name in record.tasks:
        if name in state.left:
            state.courses.setdefault(name, [])
    BEGIN_SIMULATED.get(event.change, _change_nothing_else)(state, event)
    update_speeds(state)
    return len(state.records) - 1


def _end_change(state: SimState, event: MissionEvent, record: int) -> None:
    integrate_loads(state)
    state.happening = {name: other for name, other in state.happening.items() if name != event.name}
    state.overlay = _build_overlay(state)
    state.records[record] = replace(state.records[record], until=state.env.now)
    END_SIMULATED.get(event.change, _change_nothing_else)(state, event)
    update_speeds(state)


def _build_overlay(state: SimState) -> Overlay:
    """What all changes that hold now do to the model; of two of the same value, the later one counts."""
    overlay = Overlay()
    for event in state.happening.values():
        if event.load is not None:
            overlay.loads.setdefault(event.load.host, []).append(event.load)
        if event.link is not None:
            pair = (event.link.edge, event.link.robot)
            if event.link.throughput is not None:
                overlay.throughputs[pair] = event.link.throughput
            if event.link.delay is not None:
                overlay.delays[pair] = event.link.delay
        if event.lost is not None:
            overlay.lost.add(event.lost)
        if event.demand is not None:
            overlay.demands[event.demand.task] = {
                **overlay.demands.get(event.demand.task, {}),
                **event.demand.demand,
            }
    return overlay


def _change_nothing_else(_state: SimState, _event: MissionEvent) -> None:
    """Of a change that the overlay alone makes."""


def _lose_host(state: SimState, event: MissionEvent) -> None:
    """The processes of the host are gone, as after a power failure."""
    state.services = {name: service for name, service in state.services.items() if service.host != event.lost}


def _return_host(state: SimState, event: MissionEvent) -> None:
    """The host answers again; of its tasks only those run that edgectl does not manage."""
    _start_external_tasks(state, lambda _, host: host == event.lost and host not in state.overlay.lost)


def _admit_tasks(state: SimState, _event: MissionEvent) -> None:
    state.tasks = select_present_tasks(state.all_tasks, state.scenario.events, state.happened)
    _start_external_tasks(state, lambda _, host: host not in state.overlay.lost)


def _start_external_tasks(state: SimState, starts: Callable[[str, str], bool]) -> None:
    for name, host in list_external_placements(state):
        if name not in state.services and starts(name, host):
            state.services[name] = SimTask(
                task=state.tasks.tasks[name], host=host, since=state.env.now, ready=True
            )


# What a change does besides the overlay, when it begins and when it ends.
BEGIN_SIMULATED: Mapping[str, Callable[[SimState, MissionEvent], None]] = {
    "lost": _lose_host,
    "join": _admit_tasks,
    "add": _admit_tasks,
}
END_SIMULATED: Mapping[str, Callable[[SimState, MissionEvent], None]] = {"lost": _return_host}


def show_reading(state: SimState) -> None:
    """The manager has read the fleet: what waits for a condition looks at it now, after the plan."""
    if state.read.callbacks:
        state.read.succeed()
        state.read = state.env.event()


def _wait_for_condition(state: SimState, condition: EventCondition) -> Generator[Any, Any, None]:
    if state.scenario.timing.by_reading:
        yield state.read
        while not all(_check_condition(state, condition)):
            yield state.read
        return
    while not all(_check_condition(state, condition)):
        changed = state.changed
        seconds = _find_next_progress_s(state, condition.progress)
        yield changed if seconds is None else simpy.AnyOf(state.env, [changed, state.env.timeout(seconds)])


def _check_condition(state: SimState, condition: EventCondition) -> Iterator[bool]:
    yield all(state.left.get(task) == 0 for task in condition.completed)
    yield all(task in state.services for task in condition.placed)
    yield state.done.issuperset(condition.jobs)
    if condition.progress is not None:
        yield _compute_missing_work_s(state, condition.progress) <= _WORK_TOLERANCE_S


def _find_next_progress_s(state: SimState, progress: RobotProgress | None) -> float | None:
    """Seconds until the robot has done its share at the speeds of now; None: never, or no share is asked."""
    if progress is None:
        return None
    speed = sum(
        get_job_speed(state, part.job) for part in state.working.values() if part.robot == progress.robot
    )
    missing = _compute_missing_work_s(state, progress)
    return missing / speed if speed > 0.0 and missing > _WORK_TOLERANCE_S else None


def _compute_missing_work_s(state: SimState, progress: RobotProgress) -> float:
    """Work (s at full speed) that the robot lacks until its share is reached."""
    total = state.robot_work[progress.robot]
    done = state.robot_done.get(progress.robot, 0.0) + sum(
        part.speed * (state.env.now - part.since)
        for part in state.working.values()
        if part.robot == progress.robot
    )
    return progress.reaches * total - done
