# SPDX-License-Identifier: Apache-2.0
"""Connections that are opened before paramiko is imported, and the errors of hosts that cannot be reached."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.errors import ConnectError, HostError
from edgectl.model.inventory import Host, Role
from edgectl.transport.early_lines import EarlyLine
from edgectl.transport.fleet_transport import FleetTransport
from edgectl.transport.ssh_config import CONFIG_OVERRIDE_VARIABLE, ResolvedHost
from tests.sshd import Lab

# Logs in to a host, and prints what happened in which order.
PROGRAM = """
import json, sys, time
seen = []
def listen(event, args):
    if event == "socket.connect" and isinstance(args[1], tuple):
        seen.append("connect")
    elif event == "import" and args[0] == "paramiko.transport":
        seen.append("paramiko")
sys.addaudithook(listen)
from edgectl.model.inventory import Host, Role
from edgectl.transport.fleet_transport import FleetTransport
host = Host(name="edge1", role=Role.EDGE, **json.loads(sys.argv[1]))
transport = FleetTransport()
address = transport.address(host)
seen.append("address")
for _ in range(2):
    with transport.connect(host, timeout=60) as session:
        assert session.run("echo here", b"", timeout=60).stdout == b"here\\n"
print(json.dumps(seen))
"""


@pytest.fixture
def full_port() -> Iterator[int]:
    """A port whose queue is full: the kernel answers nobody else."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as server, socket.socket() as waiting:
        waiting.connect(server.getsockname())
        yield server.getsockname()[1]


def list_events(*, host: str, **place: object) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps({"host": host, **place})],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ,
    )
    assert done.returncode == 0, done.stderr
    events: list[str] = json.loads(done.stdout)
    return events


def test_a_host_is_connected_before_paramiko_is_imported(lab: Lab) -> None:
    """Once for each login; and to know an address needs no paramiko."""
    assert list_events(host="edge1") == ["address", "connect", "paramiko", "connect"]


def test_a_host_behind_another_is_left_to_the_login(lab: Lab) -> None:
    """Of two connections one is to the jump host in each login."""
    assert list_events(host="edge1", proxy_jump="robot1") == ["address", "paramiko", "connect", "connect"]


def list_failures(host: Host, *, timeout: float) -> list[HostError]:
    """The errors of a first login, by an early line, and of a second one."""
    transport, errors = FleetTransport(), []
    for _ in range(2):
        with pytest.raises(HostError) as caught:
            transport.connect(host, timeout=timeout)
        errors.append(caught.value)
    return errors


@pytest.mark.parametrize("address", ["127.0.0.1", "no-such-host.invalid"])
def test_a_first_login_fails_like_others(lab: Lab, address: str) -> None:
    first, second = list_failures(Host(name="x", role=Role.EDGE, host=address, port=1), timeout=10)
    assert type(first) is type(second) is ConnectError
    assert (first.message, first.hint, first.host) == (second.message, second.hint, second.host)


def test_a_first_login_says_how_long_it_waited(
    full_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "ssh_config"
    config.write_text("ConnectTimeout 1\n")
    monkeypatch.setenv(CONFIG_OVERRIDE_VARIABLE, str(config))
    errors = list_failures(Host(name="x", role=Role.EDGE, host="127.0.0.1", port=full_port), timeout=60)
    words = f"no answer from 127.0.0.1 port {full_port} within 1 s"
    assert [error.message for error in errors] == [words, words]
    assert {error.host for error in errors} == {"x"}


def test_an_early_line_is_taken_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        place = ResolvedHost(
            name="x", given="x", hostname="127.0.0.1", port=server.getsockname()[1], user="me"
        )
        early = EarlyLine(place, float("inf"))
        taken = early.take()
        assert taken is not None
        with taken:
            assert taken.getpeername() == server.getsockname()
        assert early.take() is None


def test_the_error_of_an_early_line_is_told_once() -> None:
    early = EarlyLine(
        ResolvedHost(name="x", given="x", hostname="127.0.0.1", port=1, user="me"), float("inf")
    )
    with pytest.raises(ConnectionRefusedError):
        early.take()
    assert early.take() is None
