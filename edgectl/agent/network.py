"""The network profiler: bytes/s between this host and each robot, round-trip time, reachability, and totals per interface.

A connection belongs to a robot when its *remote* address is the robot's: pretend fleets live on one machine with loopback
addresses, where both ends of a connection are visible. The kernel counts bytes per TCP connection; UDP shows in the totals only.
"""

import errno
import os
import select
import time

from . import proc, sockets
from .light import socket

# Port "discard": nobody listens, and the refusal tells the round-trip time. Never sshd: it punishes who knocks and goes.
_KNOCK_PORT = 9
_ALIVE = (0, errno.ECONNREFUSED)
_RESOLVE_S = 2.0


class Flow:
    """Bytes in (``rx``) and out during the window on one connection; ``inode`` names its socket."""

    __slots__ = ("inode", "local", "remote", "rtt_ms", "rx", "tx")

    def __init__(self, local: str, remote: str, inode: int, rx: int, tx: int, rtt_ms: float) -> None:
        self.local, self.remote, self.inode, self.rx, self.tx, self.rtt_ms = (
            local,
            remote,
            inode,
            rx,
            tx,
            rtt_ms,
        )


class Traffic:
    """Counts what each connection carried between its making, or the flows before, and ``flows``."""

    def __init__(self, addresses: dict) -> None:
        """``addresses``: of the robots, by robot; other connections inside this host do not count."""
        self._wanted = _packed(addresses)
        self._farewells = sockets.Farewells(self._wanted)
        self._before = {each.key: each for each in sockets.connections(self._wanted)}
        # What ended while we were listing them ended before the window.
        self._farewells.heard()

    def flows(self) -> list:
        """A connection that appeared in the window counts in full; one that ended counts up to its end."""
        found = {each.key: each for each in self._farewells.heard()}
        then, self._before = self._before, {each.key: each for each in sockets.connections(self._wanted)}
        found.update(self._before)
        return [_flow(each, then.get(key)) for key, each in found.items()]

    def close(self) -> None:
        """Stop listening for connections that end."""
        self._farewells.close()


def since_opened(addresses: dict) -> list:
    """Flows of the open connections with all that they ever carried; ``addresses`` as in ``Traffic``."""
    return [_flow(each, None) for each in sockets.connections(_packed(addresses))]


def _packed(addresses: dict) -> set:
    return {sockets.packed(address) for found in addresses.values() for address in found}


def _flow(now, then) -> Flow:
    rx, tx = (then.rx, then.tx) if then is not None else (0, 0)
    inode = now.inode or (then.inode if then is not None else 0)
    return Flow(now.local[0], now.remote[0], inode, max(0, now.rx - rx), max(0, now.tx - tx), now.rtt_ms)


def resolve(links: list) -> dict:
    """Robot name -> its addresses. Names are looked up at once, each for at most two seconds in all."""
    found = {str(link["robot"]): _literal(str(link["address"])) for link in links}
    unknown = {str(link["robot"]): str(link["address"]) for link in links if not found[str(link["robot"])]}
    if unknown:
        import threading

        threads = [
            threading.Thread(target=_look_up, args=(found, robot, name), daemon=True)
            for robot, name in unknown.items()
        ]
        for thread in threads:
            thread.start()
        deadline = time.monotonic() + _RESOLVE_S
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))
    return dict(found)


def _literal(address: str) -> list:
    for family in (socket.AF_INET, socket.AF_INET6):
        try:
            socket.inet_pton(family, address.partition("%")[0])
        except OSError:
            continue
        return [sockets.plain_address(address.partition("%")[0])]
    return []


def _look_up(found: dict, robot: str, name: str) -> None:
    try:
        infos = socket.getaddrinfo(name, None, 0, socket.SOCK_STREAM)
    except OSError:
        return
    found[robot] = sorted({sockets.plain_address(info[4][0]) for info in infos})


class Knocks:
    """One non-blocking TCP connect to each robot, answered while the sample window passes."""

    def __init__(self, addresses: dict) -> None:
        self.rtt_ms, self.reachable = {}, {}
        self._open, self._poll = {}, select.poll()
        for robot, found in addresses.items():
            self.reachable[robot] = None
            if found:
                self._knock(robot, found[0])

    def _knock(self, robot: str, address: str) -> None:
        door = socket.socket(
            socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_STREAM | socket.SOCK_NONBLOCK
        )
        started = time.monotonic()
        code = door.connect_ex((address, _KNOCK_PORT))
        if code == errno.EINPROGRESS:
            self._open[door.fileno()] = (robot, door, started)
            self._poll.register(door, select.POLLOUT)
            return
        self._note(robot, door, code, started)

    def _note(self, robot: str, door, code: int, started: float) -> None:
        self.reachable[robot] = code in _ALIVE
        if code in _ALIVE:
            # An open connection knows its round-trip time better than we, who may have been late to look.
            measured = sockets.rtt_ms(door) if code == 0 else 0.0
            self.rtt_ms[robot] = measured or (time.monotonic() - started) * 1000.0
        door.close()

    def wait(self, deadline: float) -> None:
        """Let the window pass, noting answers the moment they come."""
        while True:
            left = deadline - time.monotonic()
            for fd, _ in self._poll.poll(max(0.0, left * 1000.0)):
                robot, door, started = self._open.pop(fd)
                self._poll.unregister(fd)
                self._note(robot, door, door.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR), started)
            if left <= 0:
                break

    def close(self, addresses: dict) -> None:
        """Give up on the silent ones: unreachable where not even the link layer found them, else unknown."""
        missing = _unanswered_neighbours() if self._open else set()
        for robot, door, _ in self._open.values():
            door.close()
            if addresses[robot][0] in missing:
                self.reachable[robot] = False
        self._open.clear()


def _unanswered_neighbours() -> set:
    """IPv4 neighbours that ARP has asked for in vain."""
    rows = (line.split() for line in proc.read("/proc/net/arp").decode("ascii", "replace").splitlines()[1:])
    return {row[0] for row in rows if len(row) > 2 and int(row[2], 16) & 0x2 == 0}


def links(addresses: dict, flows: list, knocks: Knocks, seconds: float, ways: dict) -> dict:
    """Robot -> rates, round-trip time, interface (out of ``ways``) and reachability."""
    return {
        robot: dict(_link(robot, found, flows, knocks, seconds), interface=ways[robot])
        for robot, found in addresses.items()
    }


def ways(addresses: dict) -> dict:
    """Robot -> the interface through which it is reached."""
    return {robot: interface_to(found[0]) if found else None for robot, found in addresses.items()}


def _link(robot: str, addresses: list, flows: list, knocks: Knocks, seconds: float) -> dict:
    own = [flow for flow in flows if flow.remote in addresses]
    rtts = [flow.rtt_ms for flow in own if flow.rtt_ms > 0]
    moving = any(flow.rx for flow in own)
    rtt = min(rtts) if rtts else knocks.rtt_ms.get(robot)
    return {
        "rx_bytes_per_s": round(sum(flow.rx for flow in own) / seconds, 1),
        "tx_bytes_per_s": round(sum(flow.tx for flow in own) / seconds, 1),
        "rtt_ms": None if rtt is None else round(rtt, 3),
        "reachable": True if moving else knocks.reachable.get(robot),
    }


def interface_to(address: str):
    """The interface through which ``address`` is reached; None where there is no route."""
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
    return _route_v6(address) if family == socket.AF_INET6 else _route_v4(address)


def _route_v4(address: str):
    target = int.from_bytes(socket.inet_aton(address), "little")
    best = (-1, None)
    for line in proc.read("/proc/net/route").decode("ascii", "replace").splitlines()[1:]:
        row = line.split()
        mask = int(row[7], 16)
        if target & mask == int(row[1], 16) and bin(mask).count("1") > best[0]:
            best = (bin(mask).count("1"), row[0])
    return best[1]


def _route_v6(address: str):
    target = int.from_bytes(socket.inet_pton(socket.AF_INET6, address), "big")
    best = (-1, None)
    for line in proc.read("/proc/net/ipv6_route").decode("ascii", "replace").splitlines():
        row = line.split()
        length = int(row[1], 16)
        if (target ^ int(row[0], 16)) >> (128 - length) == 0 and length > best[0] and row[9] != "lo":
            best = (length, row[9])
    return best[1]


def interface_bytes() -> dict:
    """Interface -> (bytes in, bytes out) since boot."""
    found = {}
    for line in proc.read("/proc/net/dev").decode("ascii", "replace").splitlines()[2:]:
        name, _, rest = line.partition(":")
        columns = rest.split()
        found[name.strip()] = (int(columns[0]), int(columns[8]))
    return found


def rates(before: dict, after: dict, seconds: float) -> dict:
    """Interface -> bytes/s in (``rx``) and out."""
    found = {}
    for name, now in sorted(after.items()):
        then = before.get(name, now)
        found[name] = {"rx": max(0, now[0] - then[0]) / seconds, "tx": max(0, now[1] - then[1]) / seconds}
    return found


def interface(rate: dict, speed_bytes_per_s) -> dict:
    """One of ``rates`` as it stands in a reply."""
    return {
        "rx_bytes_per_s": round(rate["rx"], 1),
        "tx_bytes_per_s": round(rate["tx"], 1),
        "speed_bytes_per_s": speed_bytes_per_s,
    }


def speed(name: str):
    """Bytes/s, None where the kernel does not know: /sys says Mbit/s, -1 or nothing at all where the driver does not know (Wi-Fi, lo)."""
    text = proc.read(os.path.join("/sys/class/net", name, "speed")).decode("ascii", "replace").strip()
    return int(text) * 125000 if text.isdigit() and int(text) > 0 else None
