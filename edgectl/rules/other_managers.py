"""Detection of changes by another manager since this one last saw all hosts (ADR 0055)."""

from collections.abc import Mapping

from edgectl.model.manager_state import ManagerState
from edgectl.model.snapshot import HostSample


def is_up_to_date(manager: ManagerState, hosts: Mapping[str, HostSample]) -> bool:
    """Whether no host that answers granted the fleet to another manager since this one last saw all hosts."""
    return not any(
        host.ok and host.foreign_grant > manager.synced.get(name, 0) for name, host in hosts.items()
    )
