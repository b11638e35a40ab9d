# SPDX-License-Identifier: Apache-2.0
"""Facts of hosts for doctor: requests to all hosts, and strict decoding of the replies."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field, fields
from typing import Any

from edgectl.agent.link import protocol
from edgectl.dataclass import dataclass
from edgectl.errors import HostError, ReplyError
from edgectl.gateway.fanout import MAX_PARALLEL_HOSTS, HostReply, ask_all
from edgectl.gateway.host_probe import resolve_addresses
from edgectl.gateway.probe_reply import PROTOCOL_VERSION, ReplyContext, select_link_capacity
from edgectl.gateway.replies import (
    DoctorReply,
    ReplyDocument,
    RouteReply,
    decode_reply,
)
from edgectl.model.diagnosis import (
    Disk,
    EngineFacts,
    HardwareFacts,
    HostFacts,
    LinkFacts,
    Logind,
    RosFacts,
    ShellEnvironment,
    UnreachableHost,
)
from edgectl.model.inventory import Host, Inventory, Role
from edgectl.model.snapshot import MachineIdentity
from edgectl.model.text import escape_unprintable
from edgectl.rules.environment import drop_secrets, merge_host_environment
from edgectl.rules.ros import encode_host_ros
from edgectl.transport.base import Transport


@dataclass(frozen=True, slots=True, kw_only=True)
class SentRequest:
    """``began``: when the request left (s since 1970, our clock); ``addresses`` of the robots it named."""

    began: float
    addresses: Mapping[str, str]


def decode_host_facts(document: ReplyDocument, context: ReplyContext, asked: SentRequest) -> HostFacts:
    """The facts of the host.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range, or the document is of another host.
    """
    host = context.host
    if (
        document.get("v") != PROTOCOL_VERSION
        or document.get("op") != protocol.OP_DOCTOR
        or document.get("host") != host.name
    ):
        raise ReplyError(
            f"not a doctor reply of this host: {escape_unprintable(repr(document.get('host')))[:80]}"
        )
    reply = decode_reply(DoctorReply, document)
    began, ended = reply.clock.began, reply.clock.ended
    return HostFacts(
        login_s=max(0.0, (context.answered_at - asked.began) - (ended - began)),
        python=reply.python,
        psutil=reply.psutil,
        # It looked at its clock after we asked, and again before we had the answer.
        skew_s=(ended - context.answered_at, began - asked.began),
        machine=MachineIdentity(**_to_fields(reply.machine)),
        logind=Logind(**_to_fields(reply.logind)),
        disk=Disk(**_to_fields(reply.disk)),
        total_bytes=reply.memory.total_bytes,
        used_bytes=reply.memory.used_bytes,
        surroundings=ShellEnvironment(**_to_fields(reply.surroundings)),
        ros=RosFacts(**_to_fields(reply.ros)),
        hardware=HardwareFacts(**_to_fields(reply.hardware)),
        links={
            robot: _build_link_facts(robot, address, reply.links.get(robot, RouteReply()), context)
            for robot, address in asked.addresses.items()
        },
        engines=None
        if reply.engines is None
        else {name: EngineFacts(**_to_fields(each)) for name, each in reply.engines.items()},
    )


def _to_fields(reply: Any) -> dict[str, Any]:  # noqa: ANN401 - any dataclass
    return {each.name: getattr(reply, each.name) for each in fields(reply)}


def _build_link_facts(robot: str, address: str, reply: RouteReply, context: ReplyContext) -> LinkFacts:
    """A robot that is missing in the reply counts as an unknown name."""
    capacity, source = select_link_capacity(robot, context, reply.speed_bytes_per_s)
    return LinkFacts(
        address=address,
        found=reply.found,
        reachable=reply.reachable,
        interface=reply.interface or None,
        rtt_ms=reply.rtt_ms,
        capacity_bytes_per_s=capacity,
        capacity_source=source,
    )


# Time of a reply besides the prelude.
_OVERHEAD_S = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HostFactsOptions:
    """``timeout`` (s): from the first packet to the last byte, per host.

    ``measured``: link capacities in bytes/s by (edge, robot). ``packages``: of ROS, those that each host
    needs. ``engines``: whether container engines are asked for; ``swarm``: and whether services of a swarm
    can be created.
    """

    timeout: float = 15.0
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)
    packages: Mapping[str, Iterable[str]] = field(default_factory=dict)
    engines: bool = False
    swarm: bool = False


def collect_host_facts(
    inventory: Inventory,
    hosts: Sequence[Host],
    transport: Transport,
    options: HostFactsOptions,
    *,
    clock: Callable[[], float] = time.time,
) -> dict[str, HostFacts | UnreachableHost]:
    """The facts of each of ``hosts``, or the error."""
    addresses = resolve_addresses(inventory.robots, transport, MAX_PARALLEL_HOSTS)

    def links_of(host: Host) -> Mapping[str, str]:
        return addresses if host.role is Role.EDGE else {}

    def build(host: Host, left: float) -> dict[str, object]:
        packages = options.packages.get(host.name, ())
        return _build_doctor_request(host, links_of(host), packages, left, options)

    def decode(reply: HostReply) -> HostFacts:
        answered_at = clock()
        context = _build_facts_context(reply.host, inventory, options, answered_at)
        asked = SentRequest(began=answered_at - reply.seconds, addresses=links_of(reply.host))
        return decode_host_facts(reply.document, context, asked)

    return {
        answer.host.name: _describe_error(answer.value)
        if isinstance(answer.value, HostError)
        else answer.value
        for answer in ask_all(hosts, transport, build, decode, timeout=options.timeout)
    }


def _describe_error(error: HostError) -> UnreachableHost:
    return UnreachableHost(
        kind=error.kind, error=escape_unprintable(error.message), hint=escape_unprintable(error.hint)
    )


def _build_facts_context(
    host: Host, inventory: Inventory, options: HostFactsOptions, answered_at: float
) -> ReplyContext:
    return ReplyContext(
        host=host,
        answered_at=answered_at,
        declared={robot: value for (edge, robot), value in inventory.links.items() if edge == host.name},
        measured={robot: value for (edge, robot), value in options.measured.items() if edge == host.name},
    )


def _build_doctor_request(
    host: Host, links: Mapping[str, str], packages: Iterable[str], timeout: float, options: HostFactsOptions
) -> dict[str, object]:
    return {
        "op": protocol.OP_DOCTOR,
        "fleet": host.fleet,
        "host": host.name,
        "links": [{"robot": robot, "address": address} for robot, address in links.items()],
        "prelude": host.prelude,
        "ros": encode_host_ros(host, links.values()),
        "packages": list(packages),
        "engines": options.engines,
        **({"managers": list(host.swarm)} if options.swarm else {}),
        "env": drop_secrets(merge_host_environment(host)),
        "timeout_s": max(1.0, timeout - _OVERHEAD_S),
    }
