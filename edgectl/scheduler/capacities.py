# SPDX-License-Identifier: Apache-2.0
"""Capacities (Delta) of the fleet: hosts as numbered places, and the hosts that are closed to new work."""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from math import inf
from typing import TYPE_CHECKING

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Rejection, RejectionRule
from edgectl.model.inventory import Host, Inventory
from edgectl.model.manager_state import ManagerState, MeasuredDemand
from edgectl.model.resource import CPU, GPU, HOST_RESOURCES, NOTHING, Resource
from edgectl.model.snapshot import HostSample, LinkSample, ResourceUsage, Snapshot
from edgectl.names import natural_key
from edgectl.rules.slack import compute_slack
from edgectl.scheduler.task_usage import TaskUsage

if TYPE_CHECKING:
    from edgectl.scheduler.demand import ClassDemands

# Readings older than this are not trusted with new work.
MAX_SAMPLE_AGE_S = 60.0
# Capacities of an optional resource that make no place differ from another for what demands none of it.
_LIMITLESS = frozenset((0.0, inf, NOTHING))

# By edge; None where there is no link.
LinkRow = tuple[float | None, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Capacities:
    """The hosts by place number: edges first, then robots, each kind in natural order.

    ``raw`` holds capacities by resource before limits, ``usable`` after them, one row per resource (0 without
    a sample, infinite where the host has no such limit). ``links`` holds Delta_thp by robot and edge, None
    where the edge has no link to the robot; ``nominal_links`` what they carry at best, of which shares of the
    throughput are (ADR 0077). ``order`` is the position of each place in the natural order of all names.
    ``closed`` says why a place takes no new work; in ``hard`` that also drives away what runs
    there (drained, or left out by a what-if question). ``classes`` names the class of each place (ADR 0025),
    ``demands`` holds rho by class, of the tasks whose history decides it;
    ``history`` is what was measured. ``floors``: by running task, the measured usage below which its demand
    does not count at any place (ADR 0060). ``noise``: of the readings by host and resource, as shares of the
    capacity, where it widens the slack. ``counted``: the resources of hosts that limit some place; of the
    others every term is 1.
    """

    places: tuple[Host, ...]
    index: Mapping[str, int]
    edges: int
    order: tuple[int, ...]
    samples: tuple[HostSample | None, ...]
    raw: Mapping[str, tuple[float, ...]]
    usable: Mapping[str, tuple[float, ...]]
    links: Mapping[str, tuple[float | None, ...]]
    nominal_links: Mapping[str, tuple[float | None, ...]]
    closed: Mapping[int, Rejection]
    hard: frozenset[int]
    classes: tuple[str, ...] = ()
    demands: Mapping[str, "ClassDemands"] = field(default_factory=dict)
    history: Mapping[tuple[str, str], MeasuredDemand] = field(default_factory=dict)
    floors: Mapping[str, TaskUsage] = field(default_factory=dict)
    noise: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    counted: tuple[str, ...] = tuple(resource.name for resource in HOST_RESOURCES)

    def get_slack(self, resource: Resource, place: int) -> float:
        """The share of Delta by which ``resource`` may be exceeded at ``place`` (ADR 61, ADR 83)."""
        noise = self.noise.get(self.places[place].name, {})
        return compute_slack(resource, noise.get(resource.name, 0.0))

    def is_unreachable(self, place: int) -> bool:
        """True where the host of ``place`` should have answered and did not."""
        sample = self.samples[place]
        return not (self.is_unprobed(place) if sample is None else sample.ok)

    def is_unprobed(self, place: int) -> bool:
        """True where the host was not asked: robots without a sample are taken as reachable."""
        return place >= self.edges and self.samples[place] is None


def build_capacities(
    inventory: Inventory, snapshot: Snapshot, manager: ManagerState, without: frozenset[str]
) -> Capacities:
    """The capacities of ``inventory`` as ``snapshot`` shows it."""
    edges = sorted(inventory.edges, key=lambda host: natural_key(host.name))
    robots = sorted(inventory.robots, key=lambda host: natural_key(host.name))
    places = (*edges, *robots)
    samples = tuple(snapshot.hosts.get(host.name) for host in places)
    usages = list_measured_usages(samples)
    raw = {
        resource.name: tuple(
            [_resolve_capacity(host, usage, resource) for host, usage in zip(places, usages, strict=True)]
        )
        for resource in HOST_RESOURCES
    }
    closed = {
        place: Rejection(rule=rule)
        for place, (host, sample) in enumerate(zip(places, samples, strict=True))
        if (rule := _find_closing_rule(host, sample, manager, without)) is not None
    }
    ranked = sorted(range(len(places)), key=lambda place: natural_key(places[place].name))
    order = dict(zip(ranked, range(len(ranked)), strict=True))
    shown = list_shown_links(samples[: len(edges)])
    links = {robot.name: _list_links(inventory, edges, shown, robot.name) for robot in robots}
    return Capacities(
        places=places,
        index={host.name: place for place, host in enumerate(places)},
        edges=len(edges),
        order=tuple(order[place] for place in range(len(places))),
        samples=samples,
        raw=raw,
        usable={
            name: tuple(
                _limit_capacity(capacity, host, sample, name)
                for capacity, host, sample in zip(row, places, samples, strict=True)
            )
            for name, row in raw.items()
        },
        links={robot: now for robot, (now, _) in links.items()},
        nominal_links={robot: nominal for robot, (_, nominal) in links.items()},
        closed=closed,
        hard=frozenset(
            place
            for place, host in enumerate(places)
            if host.name in manager.draining or host.name in without
        ),
        noise=manager.noise,
        counted=tuple(
            resource.name
            for resource in HOST_RESOURCES
            if not resource.optional or not _LIMITLESS.issuperset(raw[resource.name])
        ),
    )


def update_samples(fleet: Capacities, snapshot: Snapshot) -> Capacities:
    """The fleet in another snapshot, in which hosts and links can do the same."""
    return replace(fleet, samples=tuple([snapshot.hosts.get(host.name) for host in fleet.places]))


def list_measured_usages(samples: Sequence[HostSample | None]) -> list[Mapping[str, ResourceUsage] | None]:
    """What each host said of its resources; None where it did not answer."""
    return [sample.usage if sample is not None and sample.ok else None for sample in samples]


def _resolve_capacity(host: Host, usage: Mapping[str, ResourceUsage] | None, resource: Resource) -> float:
    if usage is None:
        return 0.0
    declared = host.capacity[resource.name] if host.capacity is not None else 0.0
    seen = usage.get(resource.name)
    none = resource.absent if resource.optional else 0.0
    return none if seen is None else declared or seen.capacity


def _limit_capacity(capacity: float, host: Host, sample: HostSample | None, resource: str) -> float:
    """What is usable of ``capacity`` under the limits of ``host``, of which heat takes a part."""
    if capacity == NOTHING:
        return capacity
    usable = capacity * host.limits[resource]
    if host.max_temperature is None or resource not in (CPU.name, GPU.name):
        return usable
    from edgectl.rules.heat import compute_cool_share

    return usable * compute_cool_share(host, sample)


def list_shown_links(samples: Sequence[HostSample | None]) -> list[Mapping[str, LinkSample]]:
    """The links that each host shows, by robot."""
    return [{} if sample is None else sample.links for sample in samples]


def _list_links(
    inventory: Inventory, edges: Sequence[Host], shown: Sequence[Mapping[str, LinkSample]], robot: str
) -> tuple[LinkRow, LinkRow]:
    """Delta_thp of the link of each edge, and what it carries at best: a declared link wins unless it carries
    less now, but only an edge that reports the link has it.
    """
    found = [links.get(robot) for links in shown]
    now = tuple([None if link is None else link.capacity_bytes_per_s for link in found])
    lowered = [link for link in found if link is not None and link.nominal is not None]
    if not inventory.links and not lowered:
        return now, now
    pairs = [
        _resolve_link(link, inventory.links.get((edge.name, robot)))
        for edge, link in zip(edges, found, strict=True)
    ]
    return tuple([pair[0] for pair in pairs]), tuple([pair[1] for pair in pairs])


def _resolve_link(link: LinkSample | None, declared: float | None) -> tuple[float | None, float | None]:
    if link is None or not link.capacity_bytes_per_s:
        return (None, None) if link is None else (link.capacity_bytes_per_s, 0.0)
    now = link.capacity_bytes_per_s
    if declared is None:
        return now, link.nominal_bytes_per_s
    return declared if link.nominal is None else min(declared, now), declared


def _find_closing_rule(
    host: Host, sample: HostSample | None, manager: ManagerState, without: frozenset[str]
) -> RejectionRule | None:
    if sample is None or not sample.ok or not sample.measured:
        return RejectionRule.UNREACHABLE
    if host.name in without:
        return RejectionRule.WITHOUT
    if host.name in manager.cordons or host.name in manager.draining:
        return RejectionRule.CORDONED
    return RejectionRule.STALE if sample.sample_age_s > MAX_SAMPLE_AGE_S else None
