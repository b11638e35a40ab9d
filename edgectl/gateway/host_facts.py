"""Facts of hosts for doctor: requests to all hosts, and strict decoding of the replies."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from edgectl.agent.link import protocol
from edgectl.errors import HostError, ReplyError
from edgectl.gateway.fanout import MAX_PARALLEL_HOSTS, HostReply, ask_all
from edgectl.gateway.host_probe import resolve_robot_addresses
from edgectl.gateway.probe_reply import PROTOCOL_VERSION, ReplyContext, select_link_capacity
from edgectl.gateway.reply_fields import (
    ReplyDocument,
    escape_unprintable,
    get_finite,
    get_flag,
    get_int,
    get_number,
    get_object,
    get_objects,
    get_optional,
    get_positive,
    get_text,
)
from edgectl.model.diagnosis import Disk, HostFacts, LinkFacts, Logind, ShellEnvironment, UnreachableHost
from edgectl.model.environment import drop_secrets
from edgectl.model.inventory import Host, Inventory, Role
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
    clock = get_object(document, "clock")
    began, ended = get_finite(clock, "began"), get_finite(clock, "ended")
    memory = get_object(document, "memory")
    return HostFacts(
        login_s=max(0.0, (context.answered_at - asked.began) - (ended - began)),
        python=get_text(document, "python"),
        psutil=get_flag(document, "psutil", default=False),
        # It looked at its clock after we asked, and again before we had the answer.
        skew_s=(ended - context.answered_at, began - asked.began),
        logind=_decode_logind(get_object(document, "logind")),
        disk=_decode_disk(get_object(document, "disk")),
        total_bytes=get_positive(memory, "total_bytes"),
        used_bytes=get_number(memory, "used_bytes"),
        surroundings=_decode_surroundings(get_object(document, "surroundings")),
        links=_decode_link_facts(document, context, asked.addresses),
    )


def _decode_logind(entry: ReplyDocument) -> Logind:
    return Logind(
        user=get_text(entry, "user"),
        present=get_flag(entry, "present", default=False),
        lingers=get_flag(entry, "lingers", default=False),
        removes_ipc=get_flag(entry, "removes_ipc", default=False),
        kills=get_flag(entry, "kills", default=False),
    )


def _decode_disk(entry: ReplyDocument) -> Disk:
    return Disk(
        path=get_text(entry, "path"),
        free_bytes=get_number(entry, "free_bytes"),
        total_bytes=get_number(entry, "total_bytes"),
        files_left=get_optional(entry, "files_left", get_int),
        obstacle=get_text(entry, "obstacle"),
        in_shared_memory=get_flag(entry, "spare", default=False),
    )


def _decode_surroundings(entry: ReplyDocument) -> ShellEnvironment:
    variables = get_object(entry, "variables")
    return ShellEnvironment(
        variables={escape_unprintable(name): get_text(variables, name) for name in variables},
        status=get_optional(entry, "status", get_int),
        timed_out=get_flag(entry, "timed_out", default=False),
        last_line=get_text(entry, "said"),
    )


def _decode_link_facts(
    document: ReplyDocument, context: ReplyContext, addresses: Mapping[str, str]
) -> dict[str, LinkFacts]:
    """In the order of the inventory; a robot that is missing in the reply counts as an unknown name."""
    found = get_objects(document, "links")
    links = {}
    for robot, address in addresses.items():
        entry = found.get(robot, {})
        capacity, source = select_link_capacity(
            robot, context, get_optional(entry, "speed_bytes_per_s", get_number)
        )
        links[robot] = LinkFacts(
            address=address,
            found=get_flag(entry, "found", default=False),
            reachable=None if entry.get("reachable") is None else get_flag(entry, "reachable", default=False),
            interface=get_text(entry, "interface") or None,
            rtt_ms=get_optional(entry, "rtt_ms", get_number),
            capacity_bytes_per_s=capacity,
            capacity_source=source,
        )
    return links


# Time of a reply besides the prelude.
_OVERHEAD_S = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HostFactsOptions:
    """``timeout`` (s): from the first packet to the last byte, per host.

    ``measured``: link capacities in bytes/s by (edge, robot).
    """

    timeout: float = 15.0
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)


def collect_host_facts(
    inventory: Inventory,
    hosts: Sequence[Host],
    transport: Transport,
    options: HostFactsOptions,
    *,
    clock: Callable[[], float] = time.time,
) -> dict[str, HostFacts | UnreachableHost]:
    """The facts of each of ``hosts``, or the error."""
    addresses = resolve_robot_addresses(inventory, transport, MAX_PARALLEL_HOSTS)

    def links_of(host: Host) -> Mapping[str, str]:
        return addresses if host.role is Role.EDGE else {}

    def build(host: Host, left: float) -> dict[str, object]:
        return _build_doctor_request(host, links_of(host), left)

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


def _build_doctor_request(host: Host, links: Mapping[str, str], timeout: float) -> dict[str, object]:
    return {
        "op": protocol.OP_DOCTOR,
        "host": host.name,
        "links": [{"robot": robot, "address": address} for robot, address in links.items()],
        "prelude": host.prelude,
        "env": drop_secrets(host.env),
        "timeout_s": max(1.0, timeout - _OVERHEAD_S),
    }
