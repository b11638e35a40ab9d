"""Ask every host what ``edgectl doctor`` wants to know: all at once, each at its own risk."""

import contextlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from edgectl.errors import HostError
from edgectl.gateway.collect import addresses_of
from edgectl.gateway.decode import Context
from edgectl.gateway.facts import Asked, facts
from edgectl.gateway.fanout import fan_out
from edgectl.gateway.fields import printable
from edgectl.model.environment import public
from edgectl.model.finding import HostFacts, NoAnswer
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.transport.base import Transport
from edgectl.transport.call import call

_AT_ONCE = 32
# What an answer costs besides the prelude.
_OVERHEAD_S = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ExamineOptions:
    """``timeout`` (s): from the first packet to the last byte, per host. ``measured``: link capacities in bytes/s by (edge, robot)."""

    timeout: float = 15.0
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)


def examine(
    inventory: Inventory,
    hosts: Sequence[Host],
    transport: Transport,
    options: ExamineOptions,
    *,
    clock: Callable[[], float] = time.time,
) -> dict[str, HostFacts | NoAnswer]:
    """The facts of each of ``hosts``, or why there are none."""
    addresses = addresses_of(inventory, transport, _AT_ONCE)
    gate = threading.BoundedSemaphore(_AT_ONCE)

    def ask(host: Host) -> HostFacts | NoAnswer:
        with gate:
            return _asked(host, inventory, addresses, transport, options, clock)

    return {hosts[position].name: answer for position, answer in fan_out(ask, hosts, workers=_AT_ONCE)}


def _asked(
    host: Host,
    inventory: Inventory,
    addresses: Mapping[str, str],
    transport: Transport,
    options: ExamineOptions,
    clock: Callable[[], float],
) -> HostFacts | NoAnswer:
    links = dict(addresses) if host.role is Role.EDGE else {}
    began, instant = time.monotonic(), clock()
    try:
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(transport.connect(host, timeout=options.timeout))
            left = max(0.1, began + options.timeout - time.monotonic())
            document = call(session, _request(host, links, left), timeout=left)
        answered_at = instant + time.monotonic() - began
        return facts(document, _context(host, inventory, options, answered_at), Asked(began=instant, addresses=links))
    except HostError as error:
        return NoAnswer(kind=error.kind, error=printable(error.message), hint=printable(error.hint))


def _context(host: Host, inventory: Inventory, options: ExamineOptions, answered_at: float) -> Context:
    return Context(
        host=host,
        answered_at=answered_at,
        declared={robot: value for (edge, robot), value in inventory.links.items() if edge == host.name},
        measured={robot: value for (edge, robot), value in options.measured.items() if edge == host.name},
    )


def _request(host: Host, links: Mapping[str, str], timeout: float) -> dict[str, object]:
    return {
        "op": "doctor",
        "host": host.name,
        "links": [{"robot": robot, "address": address} for robot, address in links.items()],
        "prelude": host.prelude,
        "env": public(host.env),
        "timeout_s": max(1.0, timeout - _OVERHEAD_S),
    }
