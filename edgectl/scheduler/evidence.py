"""Evidence about one task, from hosts and the manager's record: the instances that count, its progress."""

from collections.abc import Iterable, Mapping

from edgectl.dataclass import dataclass
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import HostSample, TaskSample, TaskState
from edgectl.model.task import Task
from edgectl.rules.lost_places import LostPlace, find_lost_place
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
    found: dict[str, tuple[FoundInstance, ...]] = {}
    for place, sample in enumerate(fleet.samples):
        for name, task in sample.tasks.items() if sample and sample.ok else ():
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
    manager: ManagerState, task: Task, sightings: Iterable[FoundInstance], current: FoundInstance | None
) -> bool:
    """Marked done, or reported completed by a host whose report counts, with the present specification. A
    newer instance that is alive overrules it.
    """
    if manager.done.get(task.name) == task.spec_hash:
        return True
    finished = [
        s.sample
        for s in sightings
        if s.sample.state is TaskState.COMPLETED and s.sample.spec_hash == task.spec_hash
    ]
    newest = max((sample.generation for sample in finished), default=None)
    return newest is not None and (current is None or current.sample.generation <= newest)


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
