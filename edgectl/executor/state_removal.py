# SPDX-License-Identifier: Apache-2.0
"""Remove the state that an interrupted move has left on hosts."""

from collections.abc import Iterable

from edgectl.agent.link import protocol
from edgectl.errors import HostError
from edgectl.executor.host_requests import Request
from edgectl.executor.state_requests import build_drop_request
from edgectl.model.inventory import Host, Inventory
from edgectl.transport.agent_client import ask_host
from edgectl.transport.base import Transport
from edgectl.transport.fleet_lease import FleetLease

_TIMEOUT_S = 15.0


def drop_left_state(
    name: str, hosts: Iterable[str], inventory: Inventory, transport: Transport, lease: FleetLease | None
) -> bool:
    """Remove it from all ``hosts``; one that left the inventory keeps it until the task is started there.

    False where a host did not answer: the next apply tries again.
    """
    left = False
    for host in (inventory.hosts[each] for each in hosts if each in inventory.hosts):
        try:
            ask_host(
                transport, host, _sign(name, host, lease), timeout=_TIMEOUT_S, connect_timeout=_TIMEOUT_S
            )
        except HostError:
            left = True
    return not left


def _sign(name: str, host: Host, lease: FleetLease | None) -> Request:
    """Nothing of the task is changed, so no newer generation is a reason to refuse."""
    request = build_drop_request(name, host, protocol.MAX_GENERATION)
    return request if lease is None else {**request, "lease": lease.sign(host.name)}
