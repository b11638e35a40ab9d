# SPDX-License-Identifier: Apache-2.0
"""Evidence about one task, from hosts and the manager's record: the instances that count, its progress."""

from collections.abc import Callable, Iterable, Mapping

from edgectl.dataclass import dataclass
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import HostSample, TaskSample, TaskState
from edgectl.model.task import Task
from edgectl.rules.lost_places import LostPlace, find_lost_place
from edgectl.rules.need_runs import NO_RUN, find_restarted_need, list_followed_needs, mark_run
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.claims import Standing, find_record, judge_report


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundInstance:
    """One task found at one place."""

    place: int
    sample: TaskSample


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What is known of tasks. ``samples``: of the hosts that have one, by name."""

    fleet: Capacities
    samples: Mapping[str, HostSample]
    manager: ManagerState


def collect_instances(fleet: Capacities) -> dict[str, tuple[FoundInstance, ...]]:
    """All instances that the hosts show, by task."""
    return _join_samples(fleet, lambda sample: sample.tasks)


def collect_standbys(fleet: Capacities) -> dict[str, tuple[FoundInstance, ...]]:
    """All inactive copies that the hosts show, by task."""
    return _join_samples(fleet, lambda sample: sample.standbys)


def _join_samples(
    fleet: Capacities, get_tasks: Callable[[HostSample], Mapping[str, TaskSample]]
) -> dict[str, tuple[FoundInstance, ...]]:
    found: dict[str, tuple[FoundInstance, ...]] = {}
    for place, sample in enumerate(fleet.samples):
        for name, task in get_tasks(sample).items() if sample and sample.ok else ():
            found[name] = (*found.get(name, ()), FoundInstance(place=place, sample=task))
    return found


def select_counted(
    evidence: Evidence, task: Task, sightings: tuple[FoundInstance, ...]
) -> tuple[FoundInstance, ...]:
    """The ``sightings`` whose reports count against the record (ADR 0047)."""
    if not sightings:
        return ()
    record = find_record(task.name, evidence.manager, evidence.fleet.index, evidence.samples)
    return tuple(
        s
        for s in sightings
        if not (task.managed and s.sample.managed)
        or judge_report(task, evidence.fleet.places[s.place], s.sample, record) is not Standing.REFUSED
    )


def find_newest_instance(
    evidence: Evidence, task: Task, sightings: Iterable[FoundInstance]
) -> FoundInstance | None:
    """Of several copies that count the newer assignment wins: generation, then the remembered place, then the
    later start.
    """
    placement = evidence.manager.placements.get(task.name)
    remembered = evidence.fleet.index.get(placement.host) if placement else None
    return max(
        sightings,
        key=lambda s: (
            s.sample.generation,
            s.place == remembered,
            s.sample.started_at,
            -evidence.fleet.order[s.place],
        ),
        default=None,
    )


def is_completed(
    evidence: Evidence, task: Task, sightings: Iterable[FoundInstance], current: FoundInstance | None
) -> bool:
    """Marked done, or reported completed by a host whose report counts, with the present specification. A
    newer instance that is alive overrules it, and so does a later run of a predecessor with which it
    restarts.
    """
    finished = [
        s.sample
        for s in sightings
        if s.sample.state is TaskState.COMPLETED and s.sample.spec_hash == task.spec_hash
    ]
    newest = max(finished, key=lambda sample: sample.generation, default=None)
    if newest is not None and _is_outdated(evidence, task, newest):
        return False
    if evidence.manager.done.get(task.name) == task.spec_hash:
        return True
    return newest is not None and (current is None or current.sample.generation <= newest.generation)


def _is_outdated(evidence: Evidence, task: Task, finished: TaskSample) -> bool:
    """Whether a predecessor with ``restart: with`` is in another run than when the task was started, or has
    ended.
    """
    marks = {need.task: _mark_present_run(evidence, need.task) for need in list_followed_needs(task)}
    return find_restarted_need(task, finished.needed, marks) is not None


def _mark_present_run(evidence: Evidence, name: str) -> str:
    """The mark of the run of a task that lives now; empty where none is seen and one may live unseen."""
    hosts = evidence.samples.values()
    runs = [host.tasks[name] for host in hosts if host.ok and name in host.tasks]
    newest = max((run for run in runs if run.state.alive), key=lambda run: run.generation, default=None)
    if newest is not None:
        return mark_run(newest.instance, newest.restarts)
    placement = evidence.manager.placements.get(name)
    there = evidence.samples.get(placement.host) if placement is not None else None
    asked = all(host.ok for host in hosts) if placement is None else there is not None and there.ok
    return NO_RUN if asked else ""


def find_given_up_run(
    evidence: Evidence, task: Task, sightings: Iterable[FoundInstance]
) -> FoundInstance | None:
    """The last run of ``task``, if it ended by itself and must not be started again unasked (ADR 0022): the
    same would only happen again.

    A changed specification may do better; so may a run whose host has received a newer generation since, if
    only to stop it.
    """
    ended = [
        s
        for s in sightings
        if s.sample.managed and s.sample.given_up and s.sample.spec_hash in ("", task.spec_hash)
    ]
    last = find_newest_instance(evidence, task, ended)
    if last is None:
        return None
    placement = evidence.manager.placements.get(task.name)
    told = [sample.generations.get(task.name, 0) for sample in evidence.samples.values()]
    known = max(
        [s.sample.generation for s in sightings]
        + told
        + [placement.generation if placement is not None else 0],
        default=0,
    )
    return last if last.sample.generation >= known else None


def find_unreachable_newest_host(
    evidence: Evidence, task: Task, ours: Iterable[FoundInstance], current: FoundInstance | None
) -> str | None:
    """The silent host that has the newest copy of ``task``, as far as is known.

    A copy that is seen may be older: left behind by a host that went silent, was replaced, and came back
    after its replacement fell silent.
    """
    placement = evidence.manager.placements.get(task.name)
    place = evidence.fleet.index.get(placement.host) if placement else None
    if placement is None or place is None or not evidence.fleet.is_unreachable(place):
        return None
    return placement.host if _is_older(current, ours, placement) else None


def find_lost_newest_place(
    evidence: Evidence, task: Task, ours: Iterable[FoundInstance], current: FoundInstance | None
) -> LostPlace | None:
    """The place of the newest copy of ``task`` where the inventory no longer reaches it (ADR 0040)."""
    placement = evidence.manager.placements.get(task.name)
    if placement is None or not task.managed or not _is_older(current, ours, placement):
        return None
    if placement.host not in evidence.samples and placement.host in evidence.fleet.index:
        return None
    return find_lost_place(task.name, placement, evidence.samples, evidence.manager)


def _is_older(current: FoundInstance | None, ours: Iterable[FoundInstance], placement: Placement) -> bool:
    """Whether what is seen of a task, if anything, is older than its last known placement."""
    return current is None or (current in ours and current.sample.generation < placement.generation)


def find_unreachable_robot(evidence: Evidence, task: Task) -> str | None:
    """A robot of ``task`` that does not answer."""
    places = ((robot, evidence.fleet.index.get(robot)) for robot in task.robots)
    return next(
        (robot for robot, place in places if place is not None and evidence.fleet.is_unreachable(place)), None
    )


def get_instance_host(evidence: Evidence, sighting: FoundInstance | None) -> str | None:
    """The host of an instance."""
    return None if sighting is None else evidence.fleet.places[sighting.place].name
