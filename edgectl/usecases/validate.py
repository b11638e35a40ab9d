"""validate: what can be said of two good files without asking a host."""

from edgectl.model.assignment import Uneven
from edgectl.model.inventory import Host, Inventory
from edgectl.model.memory import Memory
from edgectl.model.snapshot import Cpu, HostSample, HostStatus, MemoryUse, Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.fleet import fleet_of
from edgectl.scheduler.uneven import uneven


def uneven_declared(inventory: Inventory, tasks: Tasks) -> tuple[Uneven, ...]:
    """Percent demands that mean different amounts on the hosts whose capacity is declared; a plan knows all of them."""
    hosts = {name: sample for name, host in inventory.hosts.items() if (sample := _declared(host)) is not None}
    return uneven(fleet_of(inventory, Snapshot(taken_at=0.0, hosts=hosts), Memory(), frozenset()), tasks)


def _declared(host: Host) -> HostSample | None:
    if host.capacity is None:
        return None
    return HostSample(
        role=host.role,
        status=HostStatus.OK,
        cpu=Cpu(cores=host.capacity.cpu, used_cores=0.0),
        memory=MemoryUse(total_bytes=host.capacity.memory, used_bytes=0.0),
    )
