# SPDX-License-Identifier: Apache-2.0
"""Probe of the fleet: hosts, links and tasks."""

import dataclasses
from collections.abc import Mapping

from edgectl.gateway import host_probe
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.link_reading import LinkObservation
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import BandwidthMeasurement, HostSample, Snapshot
from edgectl.state.heartbeats import load_heartbeats, record_orphans
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.journal_reader import read_journal_cached
from edgectl.state.manager_state import (
    load_ignored_instances,
    load_link_capacities,
    load_manager_state,
    save_link_capacities,
)
from edgectl.transport.connections import HeartbeatTransport
from edgectl.usecases.coordination import find_holder_id, refresh_state
from edgectl.usecases.doubtful_starts import load_doubtful_starts, not_heard
from edgectl.usecases.fleet import Fleet, show_nothing
from edgectl.usecases.fleet_lease import probe_within_lease
from edgectl.usecases.heartbeat import (
    load_state_with_heartbeats,
    record_noted_heartbeats,
    track_heartbeats,
)
from edgectl.usecases.live_links import measure_live_links
from edgectl.usecases.measured_demand import load_measured_demands
from edgectl.usecases.reading_noise import load_reading_noise
from edgectl.usecases.record import pin_task_starts, record_snapshot


def probe_fleet(fleet: Fleet, options: ProbeOptions | None = None) -> Snapshot:
    """Measure every host; the snapshot includes the manager's state, so that it suffices to repeat a
    decision.

    Raises:
        LockBusyError: the fleet has a lease to claim (``fleet.lease``), and another manager holds it.
        CoordinationError: the lease in etcd has run out.
    """
    if fleet.lease is None:
        refresh_state(fleet)
    measured = load_link_capacities(fleet.state, fleet.warn)
    reopened = frozenset(load_ignored_instances(fleet.state, fleet.warn))
    options = options or ProbeOptions()
    links: dict[tuple[str, str], LinkObservation] = {}
    options = dataclasses.replace(
        options,
        on_links=links.update,
        measured=measured,
        reopened=reopened,
        known_tasks=lambda: _list_known_tasks(fleet),
        former_hosts=_list_former_hosts(fleet),
        manager_id=find_holder_id(fleet),
        placed=_list_instances(fleet),
    )
    fenced = load_heartbeats(fleet.state, fleet.warn).fenced
    fleet.history.prepare()
    with record_noted_heartbeats(fleet) as note:
        tracked = dataclasses.replace(fleet, transport=HeartbeatTransport(fleet.transport, note))
        options = dataclasses.replace(options, note_heartbeat=note)
        show = fleet.show_probe if options.on_host is host_probe.ignore_host else show_nothing
        with show(list(fleet.inventory.hosts)) as heard:
            asked = options if heard is None else dataclasses.replace(options, on_host=heard)
            snapshot = probe_within_lease(
                tracked,
                lambda: host_probe.probe_hosts(
                    fleet.inventory,
                    fleet.tasks,
                    tracked.transport,
                    options=asked,
                    clock=fleet.clock,
                    lease=fleet.lease,
                ),
            )
        snapshot = measure_live_links(tracked, snapshot, links, probe_idle=options.probe_idle_links)
    _record_orphans(fleet, snapshot)
    manager = load_state_with_heartbeats(fleet)
    for host in sorted(fenced - manager.fenced):
        fleet.warn(f"{host} answers, so it is not powered off: its fence is cleared")
    snapshot = pin_task_starts(fleet, snapshot)
    record_snapshot(fleet, snapshot)
    manager = dataclasses.replace(
        _add_journaled_starts(fleet, manager, snapshot),
        measured=load_measured_demands(fleet, snapshot),
        noise=load_reading_noise(fleet, snapshot),
    )
    return dataclasses.replace(snapshot, manager=manager)


def _list_known_tasks(fleet: Fleet) -> frozenset[str]:
    """Tasks of the files, and tasks that this manager has placed."""
    return frozenset(fleet.tasks.tasks) | frozenset(load_manager_state(fleet.state, fleet.warn).placements)


def _list_instances(fleet: Fleet) -> dict[str, str]:
    """The instance of each task as this manager placed it; read only where a latency is measured."""
    if all(task.latency is None for task in fleet.tasks.tasks.values()):
        return {}
    placements = load_manager_state(fleet.state, fleet.warn).placements
    return {task: placement.instance for task, placement in placements.items()}


def _list_former_hosts(fleet: Fleet) -> frozenset[str]:
    """Hosts on which this manager has placed tasks and that left the inventory."""
    placements = load_manager_state(fleet.state, fleet.warn).placements.values()
    return frozenset(placement.host for placement in placements) - fleet.inventory.hosts.keys()


def _record_orphans(fleet: Fleet, snapshot: Snapshot) -> None:
    """Remember which tasks have no supervisor: a later silence of their host must not count as their end."""
    seen = {
        name: tuple(sorted(task for task, run in host.tasks.items() if run.orphaned))
        for name, host in snapshot.hosts.items()
        if host.ok
    }
    known = load_heartbeats(fleet.state, fleet.warn).orphans
    if any(known.get(host, ()) != tasks for host, tasks in seen.items()):
        record_orphans(fleet.state, seen)


def _add_journaled_starts(fleet: Fleet, manager: ManagerState, snapshot: Snapshot) -> ManagerState:
    """The manager's state with starts that only the journal or etcd records, on hosts that are unreachable
    now or show that very start.

    An edgectl that was killed before it saved its state may have started them, here or on another machine;
    without them such a task would be started a second time elsewhere. Of some nobody knows whether the old
    instance was stopped before (`load_doubtful_starts`): while both hosts are silent, the task counts as
    where it was.
    """
    doubtful = load_doubtful_starts(fleet)
    unsure = {
        task
        for task, start in doubtful.items()
        if not_heard(snapshot, start.host) and _may_be_where_it_was(manager, snapshot, task)
    }
    begun = {task: (start.host, start.generation) for task, start in doubtful.items() if task not in unsure}
    manager = _add_contacts(manager, {task: doubtful[task].host for task in unsure})
    for task, (host, generation) in read_journal_cached(fleet.state / JOURNAL_FILE_NAME).located.items():
        if task not in begun or begun[task][1] < generation:
            begun[task] = (host, generation)
    started = {
        task: Placement(host=host, since=_find_start(snapshot, host, task), generation=generation)
        for task, (host, generation) in begun.items()
        if host not in snapshot.hosts or _may_have_started(snapshot.hosts[host], task, generation)
        if task not in manager.placements or manager.placements[task].generation < generation
    }
    return dataclasses.replace(manager, placements={**manager.placements, **started}) if started else manager


def _may_be_where_it_was(manager: ManagerState, snapshot: Snapshot, task: str) -> bool:
    placement = manager.placements.get(task)
    return (
        placement is not None and not_heard(snapshot, placement.host) and placement.host not in manager.fenced
    )


def _add_contacts(manager: ManagerState, also: Mapping[str, str]) -> ManagerState:
    """``manager``, where the silence of a task's place counts no earlier than that of the host where the task
    may be ``also``.
    """
    contact = dict(manager.contact)
    for task, host in also.items():
        place = manager.placements[task].host
        if place in contact and host in contact:
            contact[place] = max(contact[place], contact[host])
    return dataclasses.replace(manager, contact=contact) if also else manager


def _may_have_started(host: HostSample, task: str, generation: int) -> bool:
    return not host.ok or (task in host.tasks and host.tasks[task].generation == generation)


def _find_start(snapshot: Snapshot, host: str, task: str) -> float:
    sample = snapshot.hosts.get(host)
    found = sample.tasks.get(task) if sample is not None else None
    return snapshot.taken_at if found is None else found.started_at


def measure_links(fleet: Fleet, *, seconds: float = 2.0) -> tuple[BandwidthMeasurement, ...]:
    """Measure the capacity of each link by sending for ``seconds``, one link at a time, and save it."""
    from edgectl.gateway.bandwidth import measure_bandwidth

    with track_heartbeats(fleet) as tracked:
        measurements = tuple(measure_bandwidth(fleet.inventory, tracked.transport, seconds=seconds))
    known = dict(load_link_capacities(fleet.state, fleet.warn))
    known |= {
        (found.edge, found.robot): found.bytes_per_s
        for found in measurements
        if found.bytes_per_s is not None
    }
    save_link_capacities(fleet.state, known)
    return measurements
