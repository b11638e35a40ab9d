# SPDX-License-Identifier: Apache-2.0
"""UDP sockets: the kernel has no byte counters for them, so of their traffic only its existence is known."""

import sys
import time

from . import proc, system_files
from .sockets import socket, unmap_address

_FAMILIES = {8: socket.AF_INET, 32: socket.AF_INET6}
_TABLES = ("udp", "udp6")
_COUNTERS = (b"InDatagrams", b"OutDatagrams", b"Udp6InDatagrams", b"Udp6OutDatagrams")
# The ports that the kernel gives to sockets which ask for none, where it does not say.
_EPHEMERAL = (32768, 60999)
# Each node of roscpp opens a socket on such a port and never uses it: such sockets count while this host
# carries more datagrams than its name service and clock.
_BUSY_PER_S = 20.0


class UdpMeter:
    """Meter of the UDP sockets that may carry traffic between its creation and ``find_sockets``.

    ``counters`` of both: as ``proc.read_network_counters``, read a moment ago.
    """

    def __init__(self, counters: bytes) -> None:
        self._since, self._before = time.monotonic(), _count_datagrams(counters)

    def find_sockets(self, counters: bytes) -> "dict[int, str]":
        """Find inode -> remote address (empty: it sends to any) of the sockets that leave this address.

        The next call looks at the time since this one.
        """
        since, before = self._since, self._before
        self._since, self._before = time.monotonic(), _count_datagrams(counters)
        rate = (self._before - before) / max(1e-3, self._since - since)
        return find_sockets(rate >= _BUSY_PER_S)


def find_sockets(busy: bool) -> "dict[int, str]":
    """Find the sockets as ``UdpMeter``; ``busy``: those on ports that the kernel chose are in use."""
    least, most = _read_ephemeral_ports()
    found: "dict[int, str]" = {}
    for name in _TABLES:
        for line in system_files.read_file("/proc/net/" + name).decode("ascii", "replace").splitlines()[1:]:
            row = line.split()
            (local, port), (remote, remote_port) = _parse_end(row[1]), _parse_end(row[2])
            if remote_port:
                found[int(row[9])] = remote
            elif not local.startswith("127.") and local != "::1" and (busy or not least <= port <= most):
                found[int(row[9])] = ""
    return found


def _parse_end(text: str) -> "tuple[str, int]":
    """Parse address and port; the words of an address are in the byte order of this machine."""
    address, _, port = text.partition(":")
    raw = b"".join(
        int(address[at : at + 8], 16).to_bytes(4, sys.byteorder) for at in range(0, len(address), 8)
    )
    return unmap_address(socket.inet_ntop(_FAMILIES[len(address)], raw)), int(port, 16)


def _read_ephemeral_ports() -> "tuple[int, int]":
    words = system_files.read_file("/proc/sys/net/ipv4/ip_local_port_range").split()
    return (int(words[0]), int(words[1])) if len(words) > 1 else _EPHEMERAL


def _count_datagrams(counters: bytes) -> int:
    """Count the datagrams that this network namespace has received and sent."""
    found = proc.find_counters(counters, b"Udp")
    for row in system_files.read_file("/proc/net/snmp6").splitlines():
        if row.startswith(b"Udp6"):
            name, _, value = row.partition(b" ")
            found[name] = value
    return sum(int(found.get(name, 0)) for name in _COUNTERS)
