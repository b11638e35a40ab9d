"""What no placement changes: the hosts as numbered places, their capacities and who is closed to new work."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from edgectl.model.assignment import Rejection, RejectionRule
from edgectl.model.inventory import Host, Inventory
from edgectl.model.manager_state import ManagerState, MeasuredDemand
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.task import Demand
from edgectl.names import natural_key

# Readings older than this are not trusted with new work (DESIGN 5.5 "fresh", PAPER-GAPS A26).
MAX_SAMPLE_AGE_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Capacities:
    """The hosts by place number: edges first, then robots, each kind in natural order.

    ``raw_cpu``/``raw_memory`` are capacities before limits, ``cpu``/``memory`` after them (cores, bytes; 0 without a sample).
    ``links`` holds Delta_thp by robot and edge, None where the edge has no link to the robot. ``order`` is the position of each
    place in the natural order of all names. ``closed`` says why a place takes no new work; in ``hard`` that also drives away
    what runs there (drained, or left out by a what-if question). ``classes`` names the class of each place (ADR 0025), ``demands``
    holds rho by task and class, of tasks whose history decides it, "" for a class without enough; ``history`` is what was measured.
    """

    places: tuple[Host, ...]
    index: Mapping[str, int]
    edges: int
    order: tuple[int, ...]
    samples: tuple[HostSample | None, ...]
    raw_cpu: tuple[float, ...]
    raw_memory: tuple[float, ...]
    cpu: tuple[float, ...]
    memory: tuple[float, ...]
    links: Mapping[str, tuple[float | None, ...]]
    closed: Mapping[int, Rejection]
    hard: frozenset[int]
    classes: tuple[str, ...] = ()
    demands: Mapping[str, Mapping[str, Demand]] = field(default_factory=dict)
    history: Mapping[tuple[str, str], MeasuredDemand] = field(default_factory=dict)

    def is_unreachable(self, place: int) -> bool:
        """Whether the host of ``place`` should have answered and did not."""
        sample = self.samples[place]
        return not (self.is_unprobed(place) if sample is None else sample.ok)

    def is_unprobed(self, place: int) -> bool:
        """Whether nothing was asked of this host: robots without a sample are taken as reachable."""
        return place >= self.edges and self.samples[place] is None


def build_capacities(
    inventory: Inventory, snapshot: Snapshot, memory: ManagerState, without: frozenset[str]
) -> Capacities:
    """The fleet of ``inventory`` as ``snapshot`` shows it."""
    edges = sorted(inventory.edges, key=lambda host: natural_key(host.name))
    robots = sorted(inventory.robots, key=lambda host: natural_key(host.name))
    places = (*edges, *robots)
    samples = tuple(snapshot.hosts.get(host.name) for host in places)
    raw_cpu = tuple(_resolve_cores(host, sample) for host, sample in zip(places, samples, strict=True))
    raw_memory = tuple(
        _resolve_memory_bytes(host, sample) for host, sample in zip(places, samples, strict=True)
    )
    closed = {
        place: Rejection(rule=rule)
        for place, (host, sample) in enumerate(zip(places, samples, strict=True))
        if (rule := _find_closing_rule(host, sample, memory, without)) is not None
    }
    ranked = sorted(range(len(places)), key=lambda place: natural_key(places[place].name))
    order = dict(zip(ranked, range(len(ranked)), strict=True))
    return Capacities(
        places=places,
        index={host.name: place for place, host in enumerate(places)},
        edges=len(edges),
        order=tuple(order[place] for place in range(len(places))),
        samples=samples,
        raw_cpu=raw_cpu,
        raw_memory=raw_memory,
        cpu=tuple(raw * host.limits.cpu for raw, host in zip(raw_cpu, places, strict=True)),
        memory=tuple(raw * host.limits.memory for raw, host in zip(raw_memory, places, strict=True)),
        links={
            robot.name: tuple(_resolve_link_capacity(inventory, edge, snapshot, robot.name) for edge in edges)
            for robot in robots
        },
        closed=closed,
        hard=frozenset(
            place for place, host in enumerate(places) if host.name in memory.draining or host.name in without
        ),
    )


def _resolve_cores(host: Host, sample: HostSample | None) -> float:
    if sample is None or not sample.ok or sample.cpu is None:
        return 0.0
    return host.capacity.cpu if host.capacity is not None else sample.cpu.cores


def _resolve_memory_bytes(host: Host, sample: HostSample | None) -> float:
    if sample is None or not sample.ok or sample.memory is None:
        return 0.0
    return host.capacity.memory if host.capacity is not None else sample.memory.total_bytes


def _resolve_link_capacity(inventory: Inventory, edge: Host, snapshot: Snapshot, robot: str) -> float | None:
    """Delta_thp of one link: a declared link wins, but only an edge that reports the link has it."""
    sample = snapshot.hosts.get(edge.name)
    if sample is None or robot not in sample.links:
        return None
    found = sample.links[robot].capacity_bytes_per_s
    return inventory.links.get((edge.name, robot), found) if found > 0 else 0.0


def _find_closing_rule(
    host: Host, sample: HostSample | None, memory: ManagerState, without: frozenset[str]
) -> RejectionRule | None:
    if sample is None or not sample.ok or sample.cpu is None or sample.memory is None:
        return RejectionRule.UNREACHABLE
    if host.name in without:
        return RejectionRule.WITHOUT
    if host.name in memory.cordons or host.name in memory.draining:
        return RejectionRule.CORDONED
    return RejectionRule.STALE if sample.sample_age_s > MAX_SAMPLE_AGE_S else None
