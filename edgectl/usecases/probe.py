"""probe: measure the fleet."""

import dataclasses

from edgectl.gateway import bandwidth, host_probe
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.snapshot import BandwidthMeasurement, Snapshot
from edgectl.state.heartbeats import load_heartbeats
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.journal_reader import read_journal_cached
from edgectl.state.manager_state import load_ignored_instances, load_link_capacities, save_link_capacities
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.heartbeat import load_state_with_heartbeats, track_heartbeats
from edgectl.usecases.measured_demand import load_measured_demands
from edgectl.usecases.record import record_snapshot


def probe_fleet(fleet: Fleet, options: ProbeOptions | None = None) -> Snapshot:
    """Measure every host; the snapshot carries the memory, so that it alone is enough to repeat a decision."""
    measured = load_link_capacities(fleet.state, fleet.warn)
    reopened = frozenset(load_ignored_instances(fleet.state, fleet.warn))
    options = dataclasses.replace(options or ProbeOptions(), measured=measured, reopened=reopened)
    fenced = load_heartbeats(fleet.state, fleet.warn).fenced
    with track_heartbeats(fleet) as near:
        snapshot = host_probe.probe_hosts(
            fleet.inventory, fleet.tasks, near.transport, options=options, clock=fleet.clock
        )
    memory = load_state_with_heartbeats(fleet)
    for host in sorted(fenced - memory.fenced):
        fleet.warn(f"{host} answers, so it is not switched off: its fence is lifted")
    record_snapshot(fleet, snapshot)
    memory = dataclasses.replace(
        _add_journaled_starts(fleet, memory, snapshot), measured=load_measured_demands(fleet, snapshot)
    )
    return dataclasses.replace(snapshot, manager=memory)


def _add_journaled_starts(fleet: Fleet, memory: ManagerState, snapshot: Snapshot) -> ManagerState:
    """The memory, with what an edgectl that was killed before it saved its own may have started on hosts that are silent now.

    Only the journal knows of it; without it such a task would be started a second time elsewhere.
    """
    started = {
        task: Placement(host=host, since=snapshot.taken_at, generation=generation)
        for task, (host, generation) in read_journal_cached(fleet.state / JOURNAL_FILE_NAME).located.items()
        if host in snapshot.hosts and not snapshot.hosts[host].ok
        if task not in memory.placements or memory.placements[task].generation < generation
    }
    return dataclasses.replace(memory, placements={**memory.placements, **started}) if started else memory


def measure_links(fleet: Fleet, *, seconds: float = 2.0) -> tuple[BandwidthMeasurement, ...]:
    """Measure each link's capacity by sending for ``seconds``, one link after the other, and keep what was measured."""
    with track_heartbeats(fleet) as near:
        measurements = tuple(bandwidth.measure_bandwidth(fleet.inventory, near.transport, seconds=seconds))
    known = dict(load_link_capacities(fleet.state, fleet.warn))
    known |= {
        (found.edge, found.robot): found.bytes_per_s
        for found in measurements
        if found.bytes_per_s is not None
    }
    save_link_capacities(fleet.state, known)
    return measurements
