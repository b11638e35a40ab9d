# SPDX-License-Identifier: Apache-2.0
"""Placeholders that only the host can fill in: its own address on the way to the robots, those of others."""

from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import network, sockets
from ..measure.sockets import socket

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Iterable

_NAMES = ("host_address", "robot_address", "master")
# Nothing is sent: connecting a UDP socket only asks the kernel for the way.
_ANY_PORT = 9
# An address of no host (RFC 5737): the way to it is the default route.
_ELSEWHERE = "192.0.2.1"
_LOOPBACK = "127.0.0.1"


def fill_request(request: Document) -> Document:
    """Fill in the placeholders in the command, the environment and the checks of a request or a spec.

    Raises:
        RefusalError: one has no value here.
    """
    ros = request.get("ros")
    if not ros:
        return request
    values = _HostValues(ros)
    filled = dict(request, command=values.fill(request.get("command") or ""))
    filled["env"] = {name: values.fill(str(text)) for name, text in (request.get("env") or {}).items()}
    _fill_checks(filled, ("ready", "alive"), values)
    if request.get("activation"):
        filled["activation"] = dict(request["activation"])
        _fill_checks(filled["activation"], ("activate", "deactivate", "ready"), values)
    return filled


def _fill_checks(document: Document, keys: "Iterable[str]", values: "_HostValues") -> None:
    for key in keys:
        if document.get(key):
            document[key] = dict(document[key], command=values.fill(document[key]["command"]))


def list_setup_files(request: Document) -> "list[str]":
    """List the files to source before a command of the request."""
    return list((request.get("ros") or {}).get("setup") or [])


class _HostValues:
    """Values of the placeholders, each found when it is first needed."""

    def __init__(self, ros: Document) -> None:
        self._ros = ros
        self._found: "dict[str, str]" = {}

    def fill(self, text: str) -> str:
        """Fill in ``{name}``; ``${name}`` is left to the shell."""
        for name in _NAMES:
            head, *rest = text.split("{%s}" % name)
            parts = [head]
            for part in rest:
                left_alone = parts[-1].endswith("$")
                parts.append("{%s}" % name if left_alone else self._get_value(name))
                parts.append(part)
            text = "".join(parts)
        return text

    def _get_value(self, name: str) -> str:
        if name not in self._found:
            self._found[name] = self._find_value(name)
        return self._found[name]

    def _find_value(self, name: str) -> str:
        if name == "host_address":
            return find_own_address(self._ros.get("peers") or [])
        stated = (self._ros.get("values") or {}).get(name)
        if not stated:
            raise RefusalError(
                "start-failed",
                "{%s} has no value on this host" % name,
                "state ros: {master: ..} in the inventory" if name == "master" else "give the task one robot",
            )
        return stated if name == "master" else _resolve_name(stated)


def _resolve_name(name: str) -> str:
    found = resolve_addresses([name])
    if not found:
        raise RefusalError(
            "start-failed",
            "%s is a name that this host cannot resolve" % name,
            "write its address in the inventory",
        )
    return found[0]


def resolve_addresses(names: "Iterable[str]") -> "list[str]":
    """Resolve the first address of each name; names that are unknown here are left out."""
    links = [{"robot": name, "address": name} for name in names]
    found = network.resolve_robots(links)
    return [found[link["robot"]][0] for link in links if found.get(link["robot"])]


def find_own_address(peers: "Iterable[str]") -> str:
    """Find the address of this host on its way to ``peers``: the first that is not a loopback address.

    Without peers, the one of its default route.
    """
    found = [find_address_towards(address) for address in resolve_addresses(peers)]
    found.append(find_address_towards(_ELSEWHERE))
    known = [address for address in found if address]
    others = [address for address in known if not is_loopback(address)]
    stated = found[:-1]
    # All peers on this machine: what they see is the loopback address.
    if any(stated) and all(not address or is_loopback(address) for address in stated):
        return next(address for address in stated if address)
    return others[0] if others else known[0] if known else _LOOPBACK


def find_address_towards(address: str) -> str:
    """Find the local address from which packets to ``address`` leave; empty where there is no way."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        probe = socket.socket(family, socket.SOCK_DGRAM)
    except OSError:
        return ""
    try:
        probe.connect((address, _ANY_PORT))
        return sockets.unmap_address(str(probe.getsockname()[0]))
    except OSError:
        return ""
    finally:
        probe.close()


def is_loopback(address: str) -> bool:
    """Whether the address is one of this machine alone."""
    return address == "::1" or address.startswith("127.")


def is_own_address(address: str) -> bool:
    """Whether ``address`` is one of this host: a socket can be bound to it."""
    try:
        probe = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_DGRAM)
    except OSError:
        return False
    try:
        probe.bind((address, 0))
    except OSError:
        return False
    finally:
        probe.close()
    return True
