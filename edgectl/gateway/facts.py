"""An agent's ``doctor`` document -> HostFacts. Pure and strict, as decode."""

from collections.abc import Mapping
from dataclasses import dataclass

from edgectl.errors import ReplyError
from edgectl.gateway.decode import VERSION, Context, link_capacity
from edgectl.gateway.fields import Document, entries, finite, flag, number, optional, positive, printable, table, text, whole
from edgectl.model.finding import Disk, HostFacts, LinkFacts, Logind, Surroundings


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """When the request went out (s since 1970, our clock), and where the robots were looked for."""

    began: float
    addresses: Mapping[str, str]


def facts(document: Document, context: Context, asked: Asked) -> HostFacts:
    """What the host says of itself.

    Raises:
        ReplyError: a value is missing, of the wrong type or out of range, or the document is of another host.
    """
    host = context.host
    if document.get("v") != VERSION or document.get("op") != "doctor" or document.get("host") != host.name:
        raise ReplyError(f"not this host's answer to doctor: {printable(repr(document.get('host')))[:80]}")
    clock = table(document, "clock")
    began, ended = finite(clock, "began"), finite(clock, "ended")
    memory = table(document, "memory")
    return HostFacts(
        login_s=max(0.0, (context.answered_at - asked.began) - (ended - began)),
        python=text(document, "python"),
        psutil=flag(document, "psutil", default=False),
        # It looked at its clock after we asked, and again before we had the answer.
        skew_s=(ended - context.answered_at, began - asked.began),
        logind=_logind(table(document, "logind")),
        disk=_disk(table(document, "disk")),
        total_bytes=positive(memory, "total_bytes"),
        used_bytes=number(memory, "used_bytes"),
        surroundings=_surroundings(table(document, "surroundings")),
        links=_links(document, context, asked.addresses),
    )


def _logind(entry: Document) -> Logind:
    return Logind(
        user=text(entry, "user"),
        present=flag(entry, "present", default=False),
        lingers=flag(entry, "lingers", default=False),
        removes_ipc=flag(entry, "removes_ipc", default=False),
        kills=flag(entry, "kills", default=False),
    )


def _disk(entry: Document) -> Disk:
    return Disk(
        path=text(entry, "path"),
        free_bytes=number(entry, "free_bytes"),
        total_bytes=number(entry, "total_bytes"),
        files_left=optional(entry, "files_left", whole),
        obstacle=text(entry, "obstacle"),
        spare=flag(entry, "spare", default=False),
    )


def _surroundings(entry: Document) -> Surroundings:
    variables = table(entry, "variables")
    return Surroundings(
        variables={printable(name): text(variables, name) for name in variables},
        status=optional(entry, "status", whole),
        timed_out=flag(entry, "timed_out", default=False),
        said=text(entry, "said"),
    )


def _links(document: Document, context: Context, addresses: Mapping[str, str]) -> dict[str, LinkFacts]:
    """In the order of the inventory; a robot that the host does not mention counts as a name that it does not know."""
    found = entries(document, "links")
    links = {}
    for robot, address in addresses.items():
        entry = found.get(robot, {})
        capacity, source = link_capacity(robot, context, optional(entry, "speed_bytes_per_s", number))
        links[robot] = LinkFacts(
            address=address,
            found=flag(entry, "found", default=False),
            reachable=None if entry.get("reachable") is None else flag(entry, "reachable", default=False),
            interface=text(entry, "interface") or None,
            rtt_ms=optional(entry, "rtt_ms", number),
            capacity_bytes_per_s=capacity,
            capacity_source=source,
        )
    return links
