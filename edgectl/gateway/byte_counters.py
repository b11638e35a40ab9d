# SPDX-License-Identifier: Apache-2.0
"""Install, remove and read the byte counters of hosts, all at once."""

import ipaddress
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Annotated, TypeVar

from edgectl.agent.link import protocol
from edgectl.agent.measure import counters_rules
from edgectl.dataclass import dataclass
from edgectl.errors import HostError, ReplyError
from edgectl.gateway.fanout import MAX_PARALLEL_HOSTS, HostReply, ask_all
from edgectl.gateway.host_probe import resolve_addresses
from edgectl.gateway.probe_request import encode_addresses
from edgectl.gateway.replies import ALONE, Amount, Count, ReplyDocument, decode_reply
from edgectl.model.byte_counters import ByteCounters, RobotCounter
from edgectl.model.inventory import Host, Inventory
from edgectl.model.reported import Text
from edgectl.model.text import escape_unprintable
from edgectl.transport.base import Transport

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotCounterReply:
    """One robot, as ``model.byte_counters.RobotCounter``."""

    addresses: tuple[Text, ...] = ()
    counted: bool = False
    rx_bytes: Amount = 0.0
    tx_bytes: Amount = 0.0
    tcp_bytes: Amount = 0.0
    rx_bytes_per_s: Amount = 0.0
    tx_bytes_per_s: Amount = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CountersReply:
    """The counters of one host, as ``model.byte_counters.ByteCounters``."""

    state: Text = ""
    tasks: bool = False
    robots: Annotated[Mapping[Text, RobotCounterReply], ALONE] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class CountersFactsReply:
    """What a script for a host depends on: its nft, the user id of the login, addresses by robot."""

    nft: Text
    uid: Count
    addresses: Mapping[Text, tuple[Text, ...]]


def ask_counters(
    hosts: Sequence[Host], inventory: Inventory, transport: Transport, action: str, *, timeout: float
) -> tuple[ByteCounters, ...]:
    """The counters of ``hosts``, in their order, after ``action``: install, remove or show."""
    found = _ask_hosts(hosts, inventory, transport, action, _decode_counters, timeout)
    return tuple(
        _describe_error(host, value) if isinstance(value, HostError) else value
        for host, value in ((host, found[host.name]) for host in hosts)
    )


def build_counters_script(
    host: Host, inventory: Inventory, transport: Transport, action: str, *, timeout: float
) -> str:
    """The script that root runs on ``host`` to ``install`` or ``remove`` its counters.

    It is built here of values that are checked: what a host sends is not run by root.

    Raises:
        HostError: the host did not answer, or its answer is of no use.
    """
    found = _ask_hosts([host], inventory, transport, "facts", _decode_facts, timeout)[host.name]
    if isinstance(found, HostError):
        raise found
    if action == "remove":
        return counters_rules.build_remove_script(host.fleet, found.nft, found.uid)
    addresses = {robot: list(each) for robot, each in found.addresses.items()}
    return counters_rules.build_install_script(host.fleet, addresses, found.nft, found.uid)


def _ask_hosts(
    hosts: Sequence[Host],
    inventory: Inventory,
    transport: Transport,
    action: str,
    decode: Callable[[HostReply], Value],
    timeout: float,
) -> dict[str, Value | HostError]:
    addresses = resolve_addresses(inventory.robots, transport, MAX_PARALLEL_HOSTS)

    def build(host: Host, _left: float) -> dict[str, object]:
        request = {"op": protocol.OP_COUNTERS, "fleet": host.fleet, "host": host.name}
        return {**request, "action": action, "links": encode_addresses(addresses)}

    return {
        answer.host.name: answer.value for answer in ask_all(hosts, transport, build, decode, timeout=timeout)
    }


def _decode_counters(reply: HostReply) -> ByteCounters:
    return decode_counters(reply.host.name, reply.document)


def decode_counters(host: str, document: ReplyDocument) -> ByteCounters:
    """The counters of a host from its reply.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range.
    """
    reply = decode_reply(CountersReply, document)
    robots = {
        name: RobotCounter(**{key: getattr(each, key) for key in RobotCounterReply.__dataclass_fields__})
        for name, each in reply.robots.items()
    }
    return ByteCounters(host=host, state=reply.state, tasks=reply.tasks, robots=robots)


def _decode_facts(reply: HostReply) -> CountersFactsReply:
    return decode_counters_facts(reply.document)


def decode_counters_facts(document: ReplyDocument) -> CountersFactsReply:
    """What a script depends on: nothing of it can be anything but a path, a number and addresses.

    Raises:
        ReplyError: a value is missing or anything else.
    """
    facts = decode_reply(CountersFactsReply, document)
    if facts.nft not in counters_rules.NFT_PATHS:
        raise ReplyError(f"unknown path of nft: {facts.nft}")
    for address in (each for found in facts.addresses.values() for each in found):
        try:
            known = "" if "%" in address else str(ipaddress.ip_address(address))
        except ValueError:
            known = ""
        if known != address:
            raise ReplyError(f"not an address: {address}")
    return facts


def _describe_error(host: Host, error: HostError) -> ByteCounters:
    return ByteCounters(
        host=host.name, error=escape_unprintable(error.message), hint=escape_unprintable(error.hint)
    )
