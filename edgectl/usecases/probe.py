"""probe: measure the fleet."""

import dataclasses

from edgectl.gateway import bandwidth, collect
from edgectl.gateway.collect import ProbeOptions
from edgectl.model.bandwidth import Measurement
from edgectl.model.memory import Memory, Placement
from edgectl.model.snapshot import Snapshot
from edgectl.state.contacts import load_contacts
from edgectl.state.journal import NAME as JOURNAL
from edgectl.state.journal_read import standing
from edgectl.state.links import load_links, save_links
from edgectl.state.reopened import load_reopened
from edgectl.usecases.demands import measured_demands
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.record import record_snapshot
from edgectl.usecases.touch import in_touch, remembered


def probe(fleet: Fleet, options: ProbeOptions | None = None) -> Snapshot:
    """Measure every host; the snapshot carries the memory, so that it alone is enough to repeat a decision."""
    measured = load_links(fleet.state, fleet.warn)
    reopened = frozenset(load_reopened(fleet.state, fleet.warn))
    options = dataclasses.replace(options or ProbeOptions(), measured=measured, reopened=reopened)
    fenced = load_contacts(fleet.state, fleet.warn).fenced
    with in_touch(fleet) as near:
        snapshot = collect.probe(fleet.inventory, fleet.tasks, near.transport, options=options, clock=fleet.clock)
    memory = remembered(fleet)
    for host in sorted(fenced - memory.fenced):
        fleet.warn(f"{host} answers, so it is not switched off: its fence is lifted")
    record_snapshot(fleet, snapshot)
    memory = dataclasses.replace(_with_starts(fleet, memory, snapshot), measured=measured_demands(fleet, snapshot))
    return dataclasses.replace(snapshot, memory=memory)


def _with_starts(fleet: Fleet, memory: Memory, snapshot: Snapshot) -> Memory:
    """The memory, with what an edgectl that was killed before it saved its own may have started on hosts that are silent now.

    Only the journal knows of it; without it such a task would be started a second time elsewhere.
    """
    started = {
        task: Placement(host=host, since=snapshot.taken_at, generation=generation)
        for task, (host, generation) in standing(fleet.state / JOURNAL).located.items()
        if host in snapshot.hosts and not snapshot.hosts[host].ok
        if task not in memory.placements or memory.placements[task].generation < generation
    }
    return dataclasses.replace(memory, placements={**memory.placements, **started}) if started else memory


def measure_links(fleet: Fleet, *, seconds: float = 2.0) -> tuple[Measurement, ...]:
    """Measure each link's capacity by sending for ``seconds``, one link after the other, and keep what was measured."""
    with in_touch(fleet) as near:
        measurements = tuple(bandwidth.measure(fleet.inventory, near.transport, seconds=seconds))
    known = dict(load_links(fleet.state, fleet.warn))
    known |= {(found.edge, found.robot): found.bytes_per_s for found in measurements if found.bytes_per_s is not None}
    save_links(fleet.state, known)
    return measurements
