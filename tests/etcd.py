# SPDX-License-Identifier: Apache-2.0
"""Real etcd servers on loopback."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from edgectl.model.inventory import Coordination
from tests.pace import patience

_START_S = 20.0
# Small, so that a lease may be as short as a second: etcd allows none below one and a half elections.
_HEARTBEAT_MS, _ELECTION_MS = 20, 200


def find_etcd() -> str:
    """The program; ``.ci/need-etcd`` puts it beside this Python."""
    found = shutil.which("etcd", path=f"{os.environ['PATH']}:{Path(sys.executable).parent}")
    assert found is not None, "the tests need etcd: .ci/need-etcd"
    return found


def reserve_port() -> socket.socket:
    """A port of loopback that nobody else gets as long as the socket is open."""
    line = socket.socket()
    line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    line.bind(("127.0.0.1", 0))
    return line


@dataclass
class EtcdServer:
    """One member of a cluster; ``port`` serves clients, the other members reach it at ``reached_at``."""

    name: str
    directory: Path
    port: int
    peer_port: int
    reached_at: int
    more: tuple[str, ...] = ()
    process: "subprocess.Popen[bytes] | None" = None

    def start(self, cluster: str) -> None:
        scheme = "https" if any("--cert-file" in word for word in self.more) else "http"
        with (self.directory / f"{self.name}.log").open("ab") as log:
            self.process = subprocess.Popen(
                [
                    find_etcd(),
                    f"--name={self.name}",
                    f"--data-dir={self.directory / self.name}",
                    f"--listen-client-urls={scheme}://127.0.0.1:{self.port}",
                    f"--advertise-client-urls={scheme}://127.0.0.1:{self.port}",
                    f"--listen-peer-urls=http://127.0.0.1:{self.peer_port}",
                    f"--initial-advertise-peer-urls=http://127.0.0.1:{self.reached_at}",
                    f"--initial-cluster={cluster}",
                    f"--heartbeat-interval={_HEARTBEAT_MS}",
                    f"--election-timeout={_ELECTION_MS}",
                    *self.more,
                ],
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
            )

    def send_signal(self, number: signal.Signals) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


@dataclass
class EtcdCluster:
    """The members of one etcd."""

    servers: list[EtcdServer] = field(default_factory=list)

    @property
    def address(self) -> str:
        return "etcd://" + ",".join(f"127.0.0.1:{server.port}" for server in self.servers)

    @property
    def place(self) -> Coordination:
        return Coordination(endpoints=tuple(("127.0.0.1", server.port) for server in self.servers))

    def start(self) -> None:
        """Start the members that do not run."""
        for server in self.servers:
            if server.process is None:
                server.start(self._describe())

    def _describe(self) -> str:
        return ",".join(f"{each.name}=http://127.0.0.1:{each.reached_at}" for each in self.servers)

    def ask(self, operation: str, body: dict[str, object]) -> dict[str, object]:
        """Ask etcd without edgectl's own client."""
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.servers[0].port}/v3/{operation}", json.dumps(body).encode()
        )
        with urllib.request.urlopen(request, timeout=5.0) as reply:
            answer: dict[str, object] = json.loads(reply.read())
            return answer

    def wait_until_healthy(self) -> None:
        deadline = time.monotonic() + patience(_START_S)
        while True:
            try:
                self.ask("kv/range", {"key": "YQ=="})
            except (OSError, ValueError, urllib.error.URLError):
                assert time.monotonic() < deadline, "etcd does not serve requests"
                time.sleep(0.02)
            else:
                return


@contextmanager
def running_etcd(
    directory: Path, size: int = 1, *more: str, relay: Callable[[int], int] | None = None
) -> Iterator[EtcdCluster]:
    """An etcd of ``size`` members that serves requests; ended with the block.

    ``relay``: opens a line to a port, through which members reach each other, and returns the port of the line.
    """
    with ExitStack() as stack:
        lines = [stack.enter_context(reserve_port()) for _ in range(2 * size)]
        ports = [line.getsockname()[1] for line in lines]
    pairs = zip(ports[::2], ports[1::2], strict=True)
    cluster = EtcdCluster(
        [
            EtcdServer(f"n{number}", directory, client, peer, relay(peer) if relay else peer, more)
            for number, (client, peer) in enumerate(pairs)
        ]
    )
    try:
        cluster.start()
        if not more:
            cluster.wait_until_healthy()
        yield cluster
    finally:
        for server in cluster.servers:
            server.kill()
