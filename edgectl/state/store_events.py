# SPDX-License-Identifier: Apache-2.0
"""Events between two snapshots of the fleet.

Pure: known state and new snapshot give events.
"""

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.model.event import Event, EventKind
from edgectl.model.snapshot import HostSample, HostStatus, Snapshot, TaskSample, TaskState
from edgectl.units import format_duration

# A snapshot slightly older than the known state was overtaken by another edgectl; one older than this (s)
# means that the clock was set back.
_OVERTAKEN_S = 600.0
# Far below the largest integer of SQLite.
_MAX_RESTARTS = 2**31
_ENDING_EVENTS = {
    TaskState.COMPLETED: EventKind.TASK_COMPLETED,
    TaskState.FAILED: EventKind.TASK_FAILED,
    TaskState.CRASHLOOP: EventKind.TASK_CRASHLOOP,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownHost:
    """A host as last seen at ``at``, with this status since ``since``.

    ``access_points``: the one that each of its radios has joined last, by interface.
    """

    at: float
    since: float
    status: HostStatus
    boot_id: str = ""
    access_points: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownTask:
    """A task as it is since ``at``. ``host`` None: gone. ``instance`` empty: not seen since an apply started
    it.
    """

    at: float
    host: str | None
    state: TaskState | None = None
    instance: str = ""
    restarts: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownFleet:
    """The last known state of every host and task ever seen."""

    hosts: Mapping[str, KnownHost] = field(default_factory=dict)
    tasks: Mapping[str, KnownTask] = field(default_factory=dict)


def sort_known_fleet(fleet: KnownFleet) -> KnownFleet:
    """``fleet`` as the file has it, by name: events of one moment are recorded in the order of the tasks."""
    return KnownFleet(hosts=dict(sorted(fleet.hosts.items())), tasks=dict(sorted(fleet.tasks.items())))


def detect_events(
    known: KnownFleet, snapshot: Snapshot, *, changing: bool = False, unfinished: Collection[str] = ()
) -> tuple[tuple[Event, ...], KnownFleet]:
    """Events of ``snapshot`` relative to the known state, and the new known state. The same or an older
    snapshot gives none.

    The first sight of a host gives no events for what is in order there. ``changing``: another edgectl is
    changing the fleet; starts and stops of tasks are left to its own record. ``unfinished``: tasks that an
    apply was changing when it was interrupted.
    """
    at = snapshot.taken_at
    hosts = {name: sample for name, sample in snapshot.hosts.items() if _is_newer(at, known.hosts.get(name))}
    events = [
        event
        for name, sample in hosts.items()
        for event in _detect_host_events(at, name, sample, known.hosts.get(name))
    ]
    after_hosts = {
        name: _update_known_host(at, sample, known.hosts.get(name)) for name, sample in hosts.items()
    }
    after_tasks: dict[str, KnownTask] = {}
    for name, now in _locate_tasks(at, hosts, known).items():
        before = known.tasks.get(name)
        if _is_newer(at, before) and not (changing and _has_arrived_or_left(before, now)):
            events += _detect_task_events(
                name,
                before,
                now,
                quiet=before is None and now.host not in known.hosts,
                unfinished=name in unfinished,
            )
            after_tasks[name] = now.known(before)
    return tuple(events), KnownFleet(
        hosts={**known.hosts, **after_hosts}, tasks={**known.tasks, **after_tasks}
    )


def _is_newer(at: float, known: KnownHost | KnownTask | None) -> bool:
    return known is None or at > known.at or known.at - at > _OVERTAKEN_S


# -- hosts -----------------------------------------------------------------------------------------


def _update_known_host(at: float, sample: HostSample, before: KnownHost | None) -> KnownHost:
    since = before.since if before is not None and before.status is sample.status else at
    boot_id = sample.device.boot_id or (before.boot_id if before else "")
    joined = _list_access_points(sample)
    points = {**(before.access_points if before is not None else {}), **joined}
    return KnownHost(at=at, since=since, status=sample.status, boot_id=boot_id, access_points=points)


def _list_access_points(sample: HostSample) -> dict[str, str]:
    interfaces = sample.device.interfaces
    return {name: each.access_point for name, each in interfaces.items() if each.access_point}


def _detect_host_events(
    at: float, host: str, sample: HostSample, before: KnownHost | None
) -> Iterator[Event]:
    was_ok = before is None or before.status is HostStatus.OK
    if not sample.ok:
        if was_ok:
            yield Event(at=at, kind=EventKind.HOST_LOST, host=host, message=sample.error)
        return
    if before is not None and not was_ok:
        yield Event(
            at=at,
            kind=EventKind.HOST_BACK,
            host=host,
            message=f"after {format_duration(max(0.0, at - before.since))}",
        )
    if before is not None and before.boot_id and sample.device.boot_id not in ("", before.boot_id):
        yield Event(
            at=at,
            kind=EventKind.HOST_REBOOTED,
            host=host,
            message="the machine has rebooted since",
        )
    for name, point in _list_access_points(sample).items():
        last = before.access_points.get(name) if before is not None else None
        if last is not None and last != point:
            yield Event(
                at=at, kind=EventKind.ROAMED, host=host, message=_describe_roaming(sample, name, last)
            )


def _describe_roaming(sample: HostSample, interface: str, last: str) -> str:
    radio = sample.device.interfaces[interface]
    since = "" if radio.joined_s is None else f" {format_duration(radio.joined_s)} ago"
    level = "" if radio.level_dbm is None else f", {radio.level_dbm:.0f} dBm"
    return f"{interface} joined {radio.access_point}{since}, after {last}{level}"


# -- tasks -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class _SeenTask:
    """A task in the snapshot: its location, or that it runs nowhere."""

    at: float
    host: str | None = None
    sample: TaskSample | None = None

    def known(self, before: KnownTask | None) -> KnownTask:
        """The new known state of the task; the same value if unchanged."""
        if self.sample is None:
            after = KnownTask(at=self.at, host=None, instance=before.instance if before else "")
        else:
            restarts = min(self.sample.restarts, _MAX_RESTARTS)
            after = KnownTask(
                at=self.at,
                host=self.host,
                state=self.sample.state,
                instance=self.sample.instance,
                restarts=restarts,
            )
        return before if before is not None and dataclasses.replace(after, at=before.at) == before else after


def _locate_tasks(at: float, hosts: Mapping[str, HostSample], known: KnownFleet) -> dict[str, _SeenTask]:
    """Locations of the tasks that the snapshot covers: a task is there, or its host answers without it."""
    found: dict[str, _SeenTask] = {}
    for host, sample in hosts.items():
        for name, task in sample.tasks.items():
            here = _SeenTask(at=at, host=host, sample=task)
            best = found.get(name)
            if _is_leftover(here, known.tasks.get(name)):
                continue
            if best is None or _rank_location(here, known.tasks.get(name)) > _rank_location(
                best, known.tasks.get(name)
            ):
                found[name] = here
    for name, before in known.tasks.items():
        there = hosts.get(before.host or "")
        if name not in found and there is not None and there.ok:
            found[name] = _SeenTask(at=at)
    return found


def _is_leftover(now: _SeenTask, before: KnownTask | None) -> bool:
    """Whether this is a leftover of an earlier run: dead, and not at the task's known location, or of an
    ended run.
    """
    if before is None or now.sample is None or now.sample.state.alive:
        return False
    return before.instance == now.sample.instance if before.host is None else before.host != now.host


def _rank_location(now: _SeenTask, before: KnownTask | None) -> tuple[bool, bool, float]:
    """Rank of one of several locations of a task: alive first, then its known location, then the latest
    start or end.
    """
    sample = now.sample or TaskSample(state=TaskState.COMPLETED)
    return (
        sample.state.alive,
        before is not None and before.host == now.host,
        max(sample.started_at, sample.ended_at or 0.0),
    )


def _has_arrived_or_left(before: KnownTask | None, now: _SeenTask) -> bool:
    if before is None or now.sample is None or before.host != now.host:
        return True
    return before.instance != now.sample.instance


_UNKNOWN_STOP = (EventKind.TASK_LOST, "gone, and not stopped by this manager")
_UNFINISHED_STOP = (EventKind.TASK_STOPPED, "by an edgectl that was interrupted before it could record it")


def _detect_task_events(
    name: str, before: KnownTask | None, now: _SeenTask, *, quiet: bool, unfinished: bool
) -> Iterator[Event]:
    if now.sample is None:
        if before is not None and before.state is not None and before.state.alive:
            kind, message = _UNFINISHED_STOP if unfinished else _UNKNOWN_STOP
            yield Event(at=now.at, kind=kind, host=before.host, task=name, message=message)
        return
    event = None if quiet else _classify_arrival(before, now.host, now.sample)
    state = before.state if before is not None else None
    if event is not None:
        kind, message = event
        yield Event(at=now.at, kind=kind, host=now.host, task=name, message=message)
        state = None
    yield from _detect_state_events(name, state, now, now.sample, fresh=event is not None or before is None)


def _classify_arrival(
    before: KnownTask | None, host: str | None, sample: TaskSample
) -> tuple[EventKind, str] | None:
    """The event that explains the task's present state, if it is new."""
    if before is None or before.host is None:
        return (EventKind.TASK_STARTED, "found running") if sample.state.alive else None
    if before.host != host:
        return EventKind.TASK_MOVED, f"found there; it was on {before.host}"
    if before.instance and sample.instance and before.instance != sample.instance:
        return EventKind.TASK_RESTARTED, "found restarted"
    if before.instance and sample.restarts > before.restarts:
        return EventKind.TASK_RESTARTED, _describe_supervisor_restarts(
            sample, sample.restarts - before.restarts
        )
    return None


def _describe_supervisor_restarts(sample: TaskSample, times: int) -> str:
    often = "once" if times == 1 else f"{times} times"
    why = "" if sample.last_exit is None else f", after exit code {sample.last_exit}"
    return f"by its supervisor {often}{why}"


def _detect_state_events(
    name: str, state: TaskState | None, now: _SeenTask, sample: TaskSample, *, fresh: bool
) -> Iterator[Event]:
    if sample.state is state:
        return
    if sample.state in _ENDING_EVENTS:
        yield Event(
            at=now.at,
            kind=_ENDING_EVENTS[sample.state],
            host=now.host,
            task=name,
            message=_describe_ending(sample),
        )
    elif sample.state is TaskState.UNHEALTHY:
        yield Event(at=now.at, kind=EventKind.TASK_UNHEALTHY, host=now.host, task=name, message=sample.detail)
    elif sample.state is TaskState.READY and not fresh:
        yield Event(at=now.at, kind=EventKind.TASK_READY, host=now.host, task=name)


def _describe_ending(sample: TaskSample) -> str:
    code = "" if sample.exit_code is None else f"exit code {sample.exit_code}"
    return "; ".join(part for part in (code, sample.detail) if part)
