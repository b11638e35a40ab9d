# SPDX-License-Identifier: Apache-2.0
"""Offline checks of valid files."""

from edgectl.model.assignment import DemandSpread
from edgectl.model.inventory import Host, Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import HostSample, HostStatus, ResourceUsage, Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.capacities import build_capacities
from edgectl.scheduler.demand_spread import find_demand_spreads


def list_uneven_demands(inventory: Inventory, tasks: Tasks) -> tuple[DemandSpread, ...]:
    """Percent demands that mean different amounts on hosts with a declared capacity."""
    hosts = {
        name: sample
        for name, host in inventory.hosts.items()
        if (sample := _sample_from_capacity(host)) is not None
    }
    return find_demand_spreads(
        build_capacities(inventory, Snapshot(taken_at=0.0, hosts=hosts), ManagerState(), frozenset()), tasks
    )


def _sample_from_capacity(host: Host) -> HostSample | None:
    if host.capacity is None or not host.is_slice:
        return None
    return HostSample(
        role=host.role,
        status=HostStatus.OK,
        usage={
            name: ResourceUsage(capacity=capacity, used=0.0)
            for name, capacity in host.capacity.items()
            if capacity
        },
    )
