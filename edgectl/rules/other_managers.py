# SPDX-License-Identifier: Apache-2.0
"""Detection of changes by another manager since this one last saw all hosts (ADR 0055), and of hosts that
another manager has and this one lacks (ADR 0068).
"""

from collections.abc import Mapping

from edgectl.model.assignment import Reason
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.snapshot import HostSample
from edgectl.names import natural_key


def is_up_to_date(manager: ManagerState, hosts: Mapping[str, HostSample]) -> bool:
    """Whether no host that answers granted the fleet to another manager since this one last saw all hosts."""
    return not any(
        host.ok and host.foreign_grant > manager.synced.get(name, 0) for name, host in hosts.items()
    )


def list_unlisted_hosts(hosts: Mapping[str, HostSample]) -> list[str]:
    """The hosts on which other managers may place tasks and that the inventory lacks, in natural order."""
    return sorted({name for host in hosts.values() for name in host.foreign_hosts}, key=natural_key)


def list_tasks_on_unlisted_hosts(plan: Plan | None) -> dict[str, str]:
    """The tasks that are held because they may run on a host that the inventory lacks, with that host."""
    steps = plan.steps if plan is not None else ()
    return {
        step.task: step.decision.subject or ""
        for step in steps
        if step.decision.reason is Reason.HOST_UNLISTED
    }


def describe_unlisted_host(host: str) -> str:
    """Where a task may run that another manager may have placed, and what to do about it."""
    return (
        f"may run on {host}, which another manager of this fleet has and this inventory lacks: add {host}, "
        f"then edgectl fence {host} if it is off"
    )
