# SPDX-License-Identifier: Apache-2.0
"""Noise of the readings of hosts, from the history."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from edgectl.model.inventory import Host
from edgectl.model.resource import MEASURED_HOST_RESOURCES, NETWORK, RESOURCES_BY_NAME, Resource
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.task import Task
from edgectl.rules.slack import MAX_READINGS, compute_slack, estimate_noise
from edgectl.usecases.fleet import Fleet

if TYPE_CHECKING:
    from edgectl.state.store import Store

_DIGITS = 4


def load_reading_noise(fleet: Fleet, snapshot: Snapshot) -> dict[str, dict[str, float]]:
    """The noise by host and resource (share of the capacity; of the network: of its noisiest link), where it
    widens the slack of a host that its tasks may overload. Others are not read.
    """
    hosts = [
        name
        for name, sample in snapshot.hosts.items()
        if name in fleet.inventory.hosts and _may_be_overloaded(fleet, fleet.inventory.hosts[name], sample)
    ]
    if not hosts:
        return {}

    def read(store: "Store") -> dict[str, dict[str, float]]:
        found = {host: _estimate_host_noise(store, host) for host in hosts}
        return {host: noise for host, noise in found.items() if noise}

    return fleet.history.use(fleet.state, fleet.warn, read)


def _may_be_overloaded(fleet: Fleet, host: Host, sample: HostSample) -> bool:
    """Whether what is used and what the tasks there demand may be more than the capacity in sum.

    A measured demand is not known here, so it may be anything.
    """
    tasks = [
        fleet.tasks.tasks[name]
        for name, run in sample.tasks.items()
        if name in fleet.tasks.tasks and run.managed and run.state.alive
    ]
    if not tasks:
        return False
    return any(
        _exceeds(usage.used, usage.capacity, usage.capacity * host.limits[resource.name], tasks, resource)
        for resource in MEASURED_HOST_RESOURCES
        if (usage := sample.usage.get(resource.name)) is not None
    ) or any(
        _exceeds(
            link.used_bytes_per_s,
            link.nominal_bytes_per_s,
            link.capacity_bytes_per_s,
            [task for task in tasks if robot in task.robots],
            NETWORK,
        )
        for robot, link in sample.links.items()
    )


def _exceeds(used: float, whole: float, usable: float, tasks: Sequence[Task], resource: Resource) -> bool:
    total = used
    for task in tasks:
        demand = task.demand[resource.name]
        if demand is None or demand.measured:
            return True
        total += demand.of(whole)
    return total > usable


def _estimate_host_noise(store: "Store", host: str) -> dict[str, float]:
    noise: dict[str, float] = {}
    for name, shares in store.used_shares(host, limit=MAX_READINGS):
        noise[name] = max(noise.get(name, 0.0), round(estimate_noise(shares), _DIGITS))
    return {name: each for name, each in noise.items() if _widens_slack(name, each)}


def _widens_slack(name: str, noise: float) -> bool:
    resource = RESOURCES_BY_NAME[name]
    return compute_slack(resource, noise) > compute_slack(resource)
