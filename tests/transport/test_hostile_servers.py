# SPDX-License-Identifier: Apache-2.0
"""SSH servers that attack the manager: each costs its own call, little memory and little time of the processor.

All attacks run at once against one process of the manager, which asks an honest host meanwhile.
"""

import json
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import paramiko
import pytest

from edgectl.errors import HostError
from edgectl.gateway.fanout import ask_all
from edgectl.model.inventory import Host, Role
from edgectl.transport.connections import SessionPool
from edgectl.transport.sockets import MAX_LOGIN_BYTES, Allowance, TunedSocket
from edgectl.transport.ssh import SshTransport
from edgectl.transport.ssh_client import BoundedTransport
from tests.hostile_sshd import ATTACKS
from tests.pace import patience
from tests.sshd import get_first_address, make_key

TIMEOUT_S = patience(2.0)
# Of the manager's memory for one host, MiB; and of its processor for all attacks together, s.
MOST_MIB, MOST_CPU_S = 50, patience(4.0)
HONEST = ("honest", "honest2")


def list_hosts(address: str, ports: list[int], key: str) -> list[Host]:
    """One host per attack, by login name, and the endless banner."""
    names = [*HONEST, *ATTACKS, "banner"]
    return [
        Host(
            name=name,
            role=Role.EDGE,
            host=address,
            user=name,
            port=ports[name == "banner"],
            identity_file=key,
        )
        for name in names
    ]


def measure_attacks(address: str, ports: list[int], key: str, timeout: float) -> None:
    """Ask an honest host, then all; print what became of each, and what it cost this process."""
    hosts = list_hosts(address, ports, key)
    found: dict[str, Any] = {}

    def ask(asked: list[Host]) -> None:
        for answer in ask_all(
            asked,
            pool,
            lambda host, _left: {"op": "probe", "host": host.name},
            lambda reply: reply.document,
            timeout=timeout,
        ):
            value = answer.value
            found[answer.host.name] = [
                value.kind if isinstance(value, HostError) else "ok",
                answer.seconds,
                value.message if isinstance(value, HostError) else "",
            ]

    with SessionPool(SshTransport()) as pool:
        ask(hosts[:1])
        memory, cpu = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        ask(hosts[1:])
        time.sleep(0.5)  # the session of an attack that begins after its reply is still open
        spent = time.process_time() - cpu
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / 1024
    print(json.dumps({"found": found, "mib": grown, "cpu_s": spent}))


@contextmanager
def serving_attacks(directory: Path, address: str) -> Iterator[tuple[list[int], dict[str, str]]]:
    """The ports of the server at ``address``, and the environment in which its key is known."""
    public = make_key(directory / "host_key")
    make_key(directory / "user_key")
    with subprocess.Popen(
        [sys.executable, "-m", "tests.hostile_sshd", str(directory / "host_key"), address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as server:
        try:
            assert server.stdout is not None
            ports = [int(word) for word in server.stdout.readline().split()]
            (directory / "known_hosts").write_text(f"[{address}]:{ports[0]} {public}\n")
            (directory / "ssh_config").write_text(
                f"Host *\n  UserKnownHostsFile {directory / 'known_hosts'}\n  GlobalKnownHostsFile none\n"
                "  IdentitiesOnly yes\n  IdentityAgent none\n"
            )
            yield ports, {**os.environ, "EDGECTL_SSH_CONFIG": str(directory / "ssh_config")}
        finally:
            server.kill()


def test_a_hostile_server_costs_its_own_call_and_little_else(tmp_path: Path) -> None:
    address = str(get_first_address())
    with serving_attacks(tmp_path, address) as (ports, environment):
        program = (
            "from tests.transport.test_hostile_servers import measure_attacks\n"
            f"measure_attacks({address!r}, {ports!r}, {str(tmp_path / 'user_key')!r}, {TIMEOUT_S})"
        )
        done = subprocess.run(
            [sys.executable, "-c", program],
            env=environment,
            capture_output=True,
            text=True,
            timeout=patience(60),
            check=True,
        )
    cost = json.loads(done.stdout)
    print(json.dumps(cost, indent=1))
    for name, (kind, seconds, message) in cost["found"].items():
        assert seconds < TIMEOUT_S + patience(2.0), (name, seconds)
        assert (kind == "ok") == (name in (*HONEST, "later")), (name, kind, message)
    assert "the host sent more than any reply has" in cost["found"]["ignore"][2]
    assert cost["found"]["honest2"][1] < TIMEOUT_S
    assert cost["mib"] < MOST_MIB, cost
    assert cost["cpu_s"] < MOST_CPU_S, cost


def test_a_server_that_renews_its_keys_without_end_is_cut() -> None:
    """Each exchange of keys takes milliseconds of both processors and few bytes."""
    ours, theirs = socket.socketpair()
    line, renewed = TunedSocket(fileno=ours.detach()), 0
    with theirs, line:
        transport: Any = BoundedTransport(line)
        line.allowance.renew(1 << 21)
        while not line.allowance.is_spent():
            with pytest.raises(paramiko.SSHException):
                transport._parse_kex_init(paramiko.Message(b""))
            renewed += 1
    assert renewed == 17


def test_no_keepalive_is_sent_while_keys_are_exchanged() -> None:
    """The thread that reads would wait half a minute for what it reads itself, whatever the deadline of a call."""
    ours, theirs = socket.socketpair()
    line = TunedSocket(fileno=ours.detach())
    with theirs, line:
        transport: Any = BoundedTransport(line)
        transport.active = True
        transport.run = lambda: transport.global_request("keepalive@lag.net", wait=False)
        transport.start()
        transport.join(patience(5.0))
        assert not transport.is_alive()


def test_an_allowance_is_of_each_call_and_adds_up_for_calls_at_once() -> None:
    allowance = Allowance()
    allowance.charge(MAX_LOGIN_BYTES)
    assert not allowance.is_spent()
    with allowance.grant(1000), allowance.grant(1000):
        allowance.charge(2000)
        assert not allowance.is_spent()
    allowance.charge(MAX_LOGIN_BYTES)  # between two calls
    assert not allowance.is_spent()
    with allowance.grant(10):
        allowance.renew(50)
        allowance.charge(51)
        assert allowance.is_spent()
    with allowance.grant(10):
        assert allowance.is_spent()  # for good: the connection is cut
