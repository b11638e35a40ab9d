# SPDX-License-Identifier: Apache-2.0
"""An edge and a robot in network namespaces of their own, with a cable between them that tbf or htb shapes. Needs root."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from edgectl.agent.link import protocol
from edgectl.model.inventory import Host
from edgectl.transport.agent_client import call_agent
from edgectl.transport.local import LocalSession, LocalTransport
from tests.builders import a_robot
from tests.faults.network import run_ip, run_tc
from tests.pace import patience

_SEND = """
import socket
peer = socket.create_connection(({address!r}, 5001))
while True:
    peer.sendall(bytes(65536))
"""
_SEND_UDP = """
import socket, time
peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
peer.connect(({address!r}, 5002))
while True:
    try:
        peer.send(bytes(1000))
    except ConnectionRefusedError:
        pass
    time.sleep(0.01)
"""
_RECEIVE = """
import socket
server = socket.create_server(("0.0.0.0", 5001))
print("listening", flush=True)
peer, _ = server.accept()
while peer.recv(65536):
    pass
"""

_SAMPLE = """
import json, sys
from edgectl.agent.measure import link_sample
link_sample._LOOK_S = {turn_s}
print(json.dumps(link_sample.sample_link(json.loads(sys.argv[1]))))
"""

_GIVE = """
import socket
server = socket.create_server(("0.0.0.0", 5003))
print("listening", flush=True)
peer, _ = server.accept()
while peer.recv(1):
    peer.sendall(bytes(77000))
"""
_ASK = """
import socket, time
peer = socket.create_connection(({address!r}, 5003))
while True:
    began, left = time.monotonic(), 77000
    peer.sendall(b"x")
    while left:
        left -= len(peer.recv(left))
    time.sleep(max(0.15, began + 0.2 - time.monotonic()))
"""

_SHAPES = {
    "tbf": ("qdisc add dev {name} root tbf rate {mbit}mbit burst 16kb latency 100ms",),
    "htb": (
        "qdisc add dev {name} root handle 1: htb default 1",
        "class add dev {name} parent 1: classid 1:1 htb rate {mbit}mbit burst 16kb",
    ),
}


def find_missing() -> str:
    """Why there can be no such network here; empty if there can."""
    lacking = [name for name in ("unshare", "nsenter", "ip", "tc") if not shutil.which(name, path=_path())]
    if os.geteuid() != 0 or lacking:
        return f"needs root, {', '.join(lacking)}"
    return ""


def _path() -> str:
    return f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"


class ShapedNetwork(LocalTransport):
    """Transport to two hosts, edge1 and robot1, whose agents run in their namespaces."""

    addresses: ClassVar = {"edge1": "10.77.7.1", "robot1": "10.77.7.2"}

    def __init__(self, folder: Path, spaces: dict[str, int]) -> None:
        self.spaces = spaces
        self._pythons = {name: folder / f"python-{name}" for name in spaces}
        for name, pid in spaces.items():
            self._pythons[name].write_text(
                f'#!/bin/sh\nexec nsenter --net=/proc/{pid}/ns/net {sys.executable} "$@"\n'
            )
            self._pythons[name].chmod(0o755)

    def connect(self, host: Host, *, timeout: float) -> LocalSession:
        """A session whose interpreter runs in the namespace of ``host``."""
        session = super().connect(host, timeout=timeout)
        session.python = str(self._pythons[host.name])
        return session

    def address(self, host: Host) -> str:
        """The address on the cable."""
        return self.addresses[host.name]

    def shape(self, mbit: float, by: str = "tbf") -> None:
        """Let the cable carry so many Mbit/s in each direction, by a bucket or by a class of ``htb``."""
        for name, pid in self.spaces.items():
            run_tc("qdisc", "del", "dev", name, "root", netns=pid)
            for words in _SHAPES[by]:
                assert not run_tc(*words.format(name=name, mbit=mbit).split(), netns=pid)

    @contextmanager
    def cut(self) -> Iterator[None]:
        """Drop whatever the edge sends over the cable; both hosts still answer edgectl."""
        pid = self.spaces["edge1"]
        # No packet is as small as the bucket.
        words = "qdisc replace dev edge1 root tbf rate 8kbit burst 10 latency 1ms"
        assert not run_tc(*words.split(), netns=pid)
        try:
            yield
        finally:
            assert not run_tc(*["qdisc", "del", "dev", "edge1", "root"], netns=pid)

    def count_received(self, name: str) -> int:
        """Bytes that the host has received over the cable."""
        lines = Path(f"/proc/{self.spaces[name]}/net/dev").read_text().splitlines()
        return int(next(line for line in lines if name in line).split()[1])

    def count_listeners(self, name: str) -> int:
        """TCP ports that listen on the host."""
        folder = Path(f"/proc/{self.spaces[name]}/net")
        rows = [
            row.split() for family in ("tcp", "tcp6") for row in (folder / family).read_text().splitlines()
        ]
        return sum(row[3] == "0A" for row in rows)

    @contextmanager
    def traffic(self, sender: str, receiver: str) -> Iterator[None]:
        """A connection over which ``sender`` sends as much as it can."""
        with self._run(receiver, _RECEIVE) as server:
            assert server.stdout is not None
            server.stdout.readline()
            with self._run(sender, _SEND.format(address=self.addresses[receiver])):
                yield

    def sample(self, seconds: float, rate: float, *, turn_s: float) -> dict[str, float | None]:
        """Probe the cable from the edge, by an agent that gets its turn every ``turn_s`` seconds only."""
        with self.connect(a_robot("robot1"), timeout=5.0) as session:
            asked = {"op": protocol.OP_SINK, "fleet": "lab", "host": "robot1", "seconds": seconds}
            sink = call_agent(session, asked, timeout=patience(5.0))
        request = {**sink, "address": self.addresses["robot1"], "seconds": seconds, "rate_bytes_per_s": rate}
        words = [str(self._pythons["edge1"]), "-c", _SAMPLE.format(turn_s=turn_s), json.dumps(request)]
        done = subprocess.run(words, capture_output=True, check=True, timeout=patience(20.0))
        found: dict[str, float | None] = json.loads(done.stdout)
        return found

    @contextmanager
    def pictures(self, sender: str, receiver: str) -> Iterator[None]:
        """A connection over which ``receiver`` asks for 77 kB, works on it for 0.15 s, and asks again, 5 times a second.

        It sends frames and no packets of 64 kB, as if a real cable were between the two.
        """
        frames = f"link set {sender} gso_max_segs 1"
        run_ip(*frames.split(), netns=self.spaces[sender])
        try:
            with self._run(sender, _GIVE) as server:
                assert server.stdout is not None
                server.stdout.readline()
                with self._run(receiver, _ASK.format(address=self.addresses[sender])):
                    yield
        finally:
            run_ip(*frames.replace(" 1", " 65535").split(), netns=self.spaces[sender])

    @contextmanager
    def udp(self, sender: str, receiver: str) -> Iterator[None]:
        """A connected UDP socket over which ``sender`` sends 100 kB/s."""
        with self._run(sender, _SEND_UDP.format(address=self.addresses[receiver])):
            yield

    @contextmanager
    def _run(self, name: str, program: str) -> "Iterator[subprocess.Popen[bytes]]":
        words = [str(self._pythons[name]), "-I", "-S", "-c", program]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        try:
            yield process
        finally:
            process.kill()
            process.communicate()


@contextmanager
def make_shaped_network(folder: Path) -> Iterator[ShapedNetwork]:
    """Two namespaces that live as long as the context."""
    keepers = {
        name: subprocess.Popen(
            ["unshare", "--net", "sh", "-c", "echo made; exec cat"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        for name in ShapedNetwork.addresses
    }
    try:
        for keeper in keepers.values():
            assert keeper.stdout is not None
            assert keeper.stdout.readline() == b"made\n"
        spaces = {name: keeper.pid for name, keeper in keepers.items()}
        edge, robot = spaces.values()
        cable = f"link add name edge1 netns {edge} type veth peer name robot1 netns {robot}"
        run_ip(*cable.split())
        for name, pid in spaces.items():
            address = f"addr add {ShapedNetwork.addresses[name]}/24 dev {name}"
            for words in ("link set lo up", address, f"link set {name} up"):
                run_ip(*words.split(), netns=pid)
        yield ShapedNetwork(folder, spaces)
    finally:
        for keeper in keepers.values():
            keeper.kill()
            keeper.communicate()
