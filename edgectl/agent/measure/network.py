# SPDX-License-Identifier: Apache-2.0
"""Network profiler: bytes/s between this host and each robot, round-trip time and reachability.

A connection belongs to a robot when its *remote* address is the robot's: on a machine that hosts a whole test
fleet with loopback addresses, both ends of a connection are visible. The kernel counts bytes per TCP
connection; UDP counts in the interface totals only, so where there is any the reading is partial, unless
counters are installed (module ``counters``).
"""

import errno
import os
import select
import time

from ..link import protocol
from ..link.fast_json import Document
from . import link_rate, proc, radio, radio_rate, sockets, system_files
from .sockets import socket

# Port "discard": nothing listens, and the refusal gives the round-trip time. Not sshd: it penalises
# unauthenticated connections.
_DISCARD_PORT = 9
_ANSWERED = (0, errno.ECONNREFUSED)
_RESOLVE_S = 2.0
# A listing that takes longer is repeated, at most so many in all: its moment decides over the rates.
_PROMPT_S, _LISTINGS = 0.01, 3

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Dict, List

    from .counters import CounterMeter, Rates

    # Robot -> its addresses.
    Addresses = Dict[str, List[str]]


class Flow:
    """Bytes in (``rx``) and out during the window on one connection; ``inode`` identifies its socket.

    ``sender``: how its sending end was limited in the window.
    """

    __slots__ = ("inode", "local", "remote", "rtt_ms", "rx", "sender", "tx")

    def __init__(
        self,
        ends: "tuple[str, str]",
        inode: int,
        rx: int,
        tx: int,
        rtt_ms: float,
        sender: "link_rate.Sender",
    ) -> None:
        self.local, self.remote = ends
        self.inode, self.rx, self.tx, self.rtt_ms, self.sender = inode, rx, tx, rtt_ms, sender


class TrafficMeter:
    """Meter of the bytes on each connection since its creation or its last measurement.

    ``seconds``: between the two listings of the last measurement, which on a loaded host are late.
    ``counters``: ``proc.read_network_counters`` before the last one.
    """

    def __init__(self, addresses: "Addresses") -> None:
        """``addresses``: addresses by robot; other connections inside this host do not count."""
        self._wanted = _pack_addresses(addresses)
        self._closed = sockets.CloseListener(self._wanted)
        self._gone: "dict[bytes, sockets.TcpConnection]" = {}
        self.counters = proc.read_network_counters()
        self._listed, self._before = self._read_promptly(self._list_connections)
        self.seconds = 0.0
        # Connections closed during that listing were closed before the window.
        self._closed.forget()

    def flows(self, opened: int = 0) -> "list[Flow]":
        """Measure: a connection that appeared in the window counts in full.

        One that was closed counts up to its end; where the kernel says so late, in the next measurement.
        ``opened``: the connections that this process has opened since, which are closed or wait for an
        answer. To list all connections takes a millisecond where the kernel's table has 262,144 buckets, so
        that where no other was opened, the known ones are looked up.
        """
        found = {each.key: each for each in self._closed.collect()}
        then, since = self._gone.copy(), self._listed
        then.update(self._before)
        before, self.counters = sockets.count_opened(self.counters), proc.read_network_counters()
        none_new = before is not None and sockets.count_opened(self.counters) == before + opened
        look = none_new and len(self._before) <= sockets.MOST_LOOK_UPS
        self._listed, self._before = self._read_promptly(self._look_up if look else self._list_connections)
        self.seconds = max(1e-3, self._listed - since)
        found.update(self._before)
        # Closed since the closed ones were collected: without this, all of its bytes would count once more.
        self._gone = {key: each for key, each in then.items() if key not in found and key not in self._gone}
        return [_build_flow(each, then.get(key)) for key, each in found.items()]

    def _list_connections(self) -> "list[sockets.TcpConnection]":
        return sockets.list_connections(self._wanted)

    def _look_up(self) -> "list[sockets.TcpConnection]":
        found = sockets.look_up_connections(self._before.values())
        return self._list_connections() if found is None else found

    def _read_promptly(
        self, read: "Callable[[], list[sockets.TcpConnection]]"
    ) -> "tuple[float, dict[bytes, sockets.TcpConnection]]":
        """Read (when, connection by key); again where this process had to wait for the CPU meanwhile."""
        began = ended = 0.0
        found: "list[sockets.TcpConnection]" = []
        for _ in range(_LISTINGS):
            began = time.monotonic()
            found = read()
            ended = time.monotonic()
            if ended - began < _PROMPT_S:
                break
        return (began + ended) / 2, {each.key: each for each in found}

    def close(self) -> None:
        """Stop listening for closed connections."""
        self._closed.close()


def read_flows_since_open(addresses: "Addresses") -> "list[Flow]":
    """Read the open connections with all bytes since they were opened.

    ``addresses`` as in ``TrafficMeter``.
    """
    return [_build_flow(each, None) for each in sockets.list_connections(_pack_addresses(addresses))]


def start_counter_meter(fleet: str, addresses: "Addresses") -> "CounterMeter | None":
    """Start the meter of the byte counters; None where there is no installation for the fleet."""
    if not addresses or not os.access(protocol.COUNTERS_FILE % fleet, os.F_OK):
        return None
    from .counters import CounterMeter

    return CounterMeter(fleet)


def _pack_addresses(addresses: "Addresses") -> "set[bytes]":
    return {sockets.pack_address(address) for found in addresses.values() for address in found}


def _build_flow(now: sockets.TcpConnection, then: "sockets.TcpConnection | None") -> Flow:
    rx, tx = (then.rx, then.tx) if then is not None else (0, 0)
    inode = now.inode or (then.inode if then is not None else 0)
    sent = max(0, now.tx - tx)
    sender = link_rate.compare_senders(then.info if then is not None else b"", now.info, sent)
    return Flow((now.local[0], now.remote[0]), inode, max(0, now.rx - rx), sent, now.rtt_ms, sender)


def resolve_robots(links: "list[Document]") -> "Addresses":
    """Resolve the addresses of each robot.

    Names are looked up in parallel, for at most two seconds in all.
    """
    found = {str(link["robot"]): _parse_address(str(link["address"])) for link in links}
    unknown = {str(link["robot"]): str(link["address"]) for link in links if not found[str(link["robot"])]}
    if unknown:
        import threading

        threads = [
            threading.Thread(target=_look_up_name, args=(found, robot, name), daemon=True)
            for robot, name in unknown.items()
        ]
        for thread in threads:
            thread.start()
        deadline = time.monotonic() + _RESOLVE_S
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))
    return dict(found)


def _parse_address(address: str) -> "list[str]":
    for family in (socket.AF_INET, socket.AF_INET6):
        try:
            packed = socket.inet_pton(family, address.partition("%")[0])
        except OSError:
            continue
        # As the kernel writes it: it is compared with the ends of connections.
        return [sockets.unmap_address(socket.inet_ntop(family, packed))]
    return []


def _look_up_name(found: "Addresses", robot: str, name: str) -> None:
    try:
        infos = socket.getaddrinfo(name, None, 0, socket.SOCK_STREAM)
    except OSError:
        return
    found[robot] = sorted({sockets.unmap_address(str(info[4][0])) for info in infos})


class ConnectProbes:
    """One non-blocking TCP connect to each robot, answered while the sample window passes."""

    def __init__(self, addresses: "Addresses") -> None:
        self.rtt_ms: "dict[str, float]" = {}
        self.reachable: "dict[str, bool | None]" = {}
        self._open: "dict[int, tuple[str, socket.socket, float]]" = {}
        self._poll = select.poll()
        # To close one takes the time of others here: the kernel wakes whoever listens for closed connections.
        self._refused: "list[socket.socket]" = []
        # Connections that the kernel has counted as opened.
        self.opened = 0
        for robot, found in addresses.items():
            self.reachable[robot] = None
            if found:
                self._start_connect(robot, found[0])

    def _start_connect(self, robot: str, address: str) -> None:
        connection = socket.socket(
            socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_STREAM | socket.SOCK_NONBLOCK
        )
        started = time.monotonic()
        code = connection.connect_ex((address, _DISCARD_PORT))
        self.opened += code in (0, errno.EINPROGRESS)
        if code == errno.EINPROGRESS:
            self._open[connection.fileno()] = (robot, connection, started)
            self._poll.register(connection, select.POLLOUT)
            return
        self._record_answer(robot, connection, code, started)

    def _record_answer(self, robot: str, connection: "socket.socket", code: int, started: float) -> None:
        self.reachable[robot] = code in _ANSWERED
        if code in _ANSWERED:
            # The kernel's round-trip time of an open connection is exact; our clock includes a late poll.
            measured = sockets.read_rtt_ms(connection) if code == 0 else 0.0
            self.rtt_ms[robot] = measured or (time.monotonic() - started) * 1000.0
        if code == errno.ECONNREFUSED:
            self._refused.append(connection)
        else:
            connection.close()

    def wait(self, deadline: float) -> None:
        """Wait until ``deadline`` (monotonic), recording each answer the moment it arrives."""
        while True:
            left = deadline - time.monotonic()
            for fd, _ in self._poll.poll(max(0.0, left * 1000.0)):
                robot, connection, started = self._open.pop(fd)
                self._poll.unregister(fd)
                self._record_answer(
                    robot, connection, connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR), started
                )
            if left <= 0:
                break

    def close(self, addresses: "Addresses") -> None:
        """Close the unanswered: unreachable where the link layer did not find them either, else unknown."""
        missing = _read_unanswered_neighbours() if self._open else set()
        for connection in self._refused:
            connection.close()
        for robot, connection, _ in self._open.values():
            connection.close()
            if addresses[robot][0] in missing:
                self.reachable[robot] = False
        self._open.clear()
        self._refused.clear()


def _read_unanswered_neighbours() -> "set[str]":
    """Read the IPv4 neighbours that did not answer ARP."""
    rows = (
        line.split()
        for line in system_files.read_file("/proc/net/arp").decode("ascii", "replace").splitlines()[1:]
    )
    return {row[0] for row in rows if len(row) > 2 and int(row[2], 16) & 0x2 == 0}


def build_links(
    addresses: "Addresses",
    flows: "list[Flow]",
    probes: ConnectProbes,
    seconds: float,
    interfaces: "dict[str, str | None]",
    udp: "dict[int, str]",
    counted: "Rates | None",
) -> "dict[str, Document]":
    """Build robot -> rates, round-trip time, interface, reachability, and what the link carries now.

    ``udp``: the sockets as ``UdpMeter.find_sockets``; a link with a connected one is partly seen, unless it
    is ``counted``.
    """
    radios, unseen = radio_rate.read_rates(interfaces.values()), set(udp.values())
    links = {}
    for robot, found in addresses.items():
        links[robot] = dict(
            _build_link(robot, found, flows, probes, seconds),
            interface=interfaces[robot],
            radio_bytes_per_s=radios.get(interfaces[robot]),
            source=protocol.SOURCE_TCP,
            partial=protocol.UDP_UNSEEN if unseen.intersection(found) else "",
        )
        if counted is not None and counted.covers(found):
            links[robot].update(_build_counted(links[robot], found, counted))
    return links


def _build_counted(link: Document, addresses: "list[str]", counted: "Rates") -> Document:
    """Build the changes of a link with counters: all protocols are in its traffic, and whatever came is an
    answer.
    """
    total = {way: sum(counted.robots[address][way] for address in addresses) for way in ("rx", "tx", "other")}
    return {
        "rx_bytes_per_s": round(total["rx"], 1),
        "tx_bytes_per_s": round(total["tx"], 1),
        "other_bytes_per_s": round(total["other"], 1),
        "reachable": True if total["rx"] else link["reachable"],
        # Where TCP met the limit of the link, the rest was under way beside it.
        "carries_bytes_per_s": None
        if link["carries_bytes_per_s"] is None
        else round(link["carries_bytes_per_s"] + total["other"], 1),
        "source": protocol.SOURCE_COUNTERS,
        "partial": "",
    }


def build_peers(peers: "Addresses", flows: "list[Flow]", seconds: float) -> "dict[str, Document]":
    """Build edge -> what its link to this robot carries now, as the robot's own sending end sees it.

    Only edges of which something is known.
    """
    found = {
        edge: link_rate.estimate_rate([flow for flow in flows if flow.remote in addresses], seconds)
        for edge, addresses in peers.items()
    }
    interfaces = find_interfaces(peers) if peers and radio.list_radios() else {}
    radios = radio_rate.read_rates(interfaces.values())
    return {
        edge: {"carries_bytes_per_s": rate, "radio_bytes_per_s": radios.get(interfaces.get(edge))}
        for edge, rate in found.items()
        if rate is not None or interfaces.get(edge) in radios
    }


def find_interfaces(addresses: "Addresses") -> "dict[str, str | None]":
    """Find the interface of the route to each robot."""
    return {robot: find_interface(found[0]) if found else None for robot, found in addresses.items()}


def _build_link(
    robot: str, addresses: "list[str]", flows: "list[Flow]", probes: ConnectProbes, seconds: float
) -> Document:
    own = [flow for flow in flows if flow.remote in addresses]
    rtts = [flow.rtt_ms for flow in own if flow.rtt_ms > 0]
    moving = any(flow.rx for flow in own)
    rtt = min(rtts) if rtts else probes.rtt_ms.get(robot)
    return {
        "rx_bytes_per_s": round(sum(flow.rx for flow in own) / seconds, 1),
        "tx_bytes_per_s": round(sum(flow.tx for flow in own) / seconds, 1),
        "rtt_ms": None if rtt is None else round(rtt, 3),
        "reachable": True if moving else probes.reachable.get(robot),
        "carries_bytes_per_s": link_rate.estimate_rate(own, seconds),
    }


def find_interface(address: str) -> "str | None":
    """Find the interface of the route to ``address``; None where there is no route."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    probe = socket.socket(family, socket.SOCK_DGRAM)
    try:
        probe.connect((address, 9))
        source = probe.getsockname()[0]
    except OSError:
        return None
    finally:
        probe.close()
    if source == address or address.startswith("127."):
        return "lo"
    return _find_route_v6(address) if family == socket.AF_INET6 else _find_route_v4(address)


def _find_route_v4(address: str) -> "str | None":
    target = int.from_bytes(socket.inet_aton(address), "little")
    best: "tuple[int, str | None]" = (-1, None)
    for line in system_files.read_file("/proc/net/route").decode("ascii", "replace").splitlines()[1:]:
        row = line.split()
        mask = int(row[7], 16)
        if target & mask == int(row[1], 16) and bin(mask).count("1") > best[0]:
            best = (bin(mask).count("1"), row[0])
    return best[1]


def _find_route_v6(address: str) -> "str | None":
    target = int.from_bytes(socket.inet_pton(socket.AF_INET6, address), "big")
    best: "tuple[int, str | None]" = (-1, None)
    for line in system_files.read_file("/proc/net/ipv6_route").decode("ascii", "replace").splitlines():
        row = line.split()
        length = int(row[1], 16)
        if (target ^ int(row[0], 16)) >> (128 - length) == 0 and length > best[0] and row[9] != "lo":
            best = (length, row[9])
    return best[1]
