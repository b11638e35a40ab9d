# SPDX-License-Identifier: Apache-2.0
"""Connections that were listed before are looked up one by one, where no other can have been opened."""

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from edgectl.agent.measure import proc, sockets
from tests.agent.test_probe import connected, has_v6, sent
from tests.pace import patience

ROBOT = "127.16.98.41"


def list_to(address: str, port: int) -> list[sockets.TcpConnection]:
    """The connections of this machine to a port of an address."""
    listed = sockets.list_connections({sockets.pack_address(address)})
    return [each for each in listed if each.remote == (address, port)]


def test_a_known_connection_is_looked_up_as_it_is_now() -> None:
    with connected(ROBOT) as (near, far):
        known = list_to(ROBOT, near.getpeername()[1])
        sent(near, far, 300_000)
        sent(far, near, 20_000)
        found = sockets.look_up_connections(known)
        listed = list_to(ROBOT, near.getpeername()[1])
    assert found is not None
    assert [(each.tx - known[0].tx, each.rx) for each in found] == [(300_000, 20_000)]
    assert [(each.key, each.inode, each.local, each.remote) for each in found] == [
        (each.key, each.inode, each.local, each.remote) for each in listed
    ]


@pytest.mark.skipif(not has_v6(), reason="this machine has no IPv6")
@pytest.mark.parametrize(("address", "name"), [("::1", "::1"), (f"::ffff:{ROBOT}", ROBOT)])
def test_sockets_of_both_families_are_looked_up(address: str, name: str) -> None:
    """IPv6, and a socket of it that has an IPv4 connection."""
    with socket.socket(socket.AF_INET6) as server, socket.socket(socket.AF_INET6) as near:
        server.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        server.bind((address, 0))
        server.listen()
        near.connect(server.getsockname()[:2])
        far, _ = server.accept()
        known = list_to(name, server.getsockname()[1])
        with far:
            sent(near, far, 40_000)
            found = sockets.look_up_connections(known)
    assert found is not None
    assert [each.tx - known[0].tx for each in found] == [40_000]


def test_a_connection_that_is_gone_is_not_found() -> None:
    """Nor one that was opened later between the same ends."""
    with socket.create_server((ROBOT, 0)) as server:
        near = socket.create_connection(server.getsockname())
        ours, theirs = near.getsockname(), near.getpeername()
        far, _ = server.accept()
        known = list_to(*theirs)
        assert len(known) == 1
        # Reset, so that the ports are free at once.
        near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        near.close()
        far.close()
        assert sockets.look_up_connections(known) == []
        with socket.socket() as again:
            again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            again.bind(ours)
            again.connect(theirs)
            assert len(list_to(*theirs)) == 1
            assert sockets.look_up_connections(known) == []


def test_of_many_those_that_are_left_are_found() -> None:
    with socket.create_server((ROBOT, 0)) as server, contextlib.ExitStack() as stack:
        ends = [socket.create_connection(server.getsockname()) for _ in range(sockets.MOST_LOOK_UPS)]
        for end in ends:
            stack.callback(end.close)
            stack.enter_context(server.accept()[0])
        known = list_to(*server.getsockname())
        kept = {end.getsockname() for end in ends[1::2]}
        for end in ends[::2]:
            end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            end.close()
        found = sockets.look_up_connections(known)
    assert len(known) == sockets.MOST_LOOK_UPS
    assert found is not None
    assert {each.local for each in found} == kept


def test_an_answer_that_says_nothing_of_the_connection_is_none() -> None:
    """As of a kernel that has no such question: all connections are listed then."""
    with connected(ROBOT) as (near, _):
        known = list_to(*near.getpeername())
        known[0].family = 99
        assert sockets.look_up_connections(known) is None


def test_each_connection_that_comes_to_be_is_counted() -> None:
    before = sockets.count_opened(proc.read_network_counters())
    with connected(ROBOT):
        after = sockets.count_opened(proc.read_network_counters())
    assert before is not None
    assert after is not None
    assert after >= before + 2, "opened at one end, accepted at the other"


# What a window costs: whether all connections were listed, and the bytes that it saw.
_SCENES = """
import json, socket, sys
from contextlib import ExitStack, closing
from edgectl.agent.measure import network, sockets
from tests.agent.test_probe import connected, sent

def measure(meter, opened=0):
    calls = []
    sys.setprofile(lambda frame, _event, _value: calls.append(frame.f_code.co_name))
    try:
        flows = meter.flows(opened)
    finally:
        sys.setprofile(None)
    return ["_query_kernel" in calls, sorted(flow.tx for flow in flows if flow.tx and flow.remote in ("ROBOT", "127.16.98.43"))]

def open_meter(robot="ROBOT"):
    return closing(network.TrafficMeter({"robot1": [robot]}))

seen = {}
with open_meter() as meter:
    seen["nothing"] = measure(meter)
with connected("ROBOT") as (near, far), open_meter() as meter:
    sent(near, far, 70_000)
    seen["known"] = measure(meter)
    sent(near, far, 5_000)
    seen["known, again"] = measure(meter)
    with connected("ROBOT") as (other, end):
        sent(other, end, 9_000)
        seen["new"] = measure(meter)
        sent(other, end, 3_000)
        seen["no longer new"] = measure(meter)
    seen["ended"] = measure(meter)[:1]
# The kernel reports closed connections with a delay: other addresses.
robot = "127.16.98.43"
with open_meter(robot) as meter:
    probes = network.ConnectProbes({"robot1": [robot], "robot2": ["127.16.98.42"]})
    probes.wait(0.0)
    seen["own probes"] = measure(meter, probes.opened)
    probes = network.ConnectProbes({"robot1": [robot]})
    probes.wait(0.0)
    with connected(robot) as (near, far):
        sent(near, far, 8_000)
        seen["own probes beside another"] = measure(meter, probes.opened)
with socket.create_server(("ROBOT", 9)), open_meter() as meter:
    probes = network.ConnectProbes({"robot1": ["ROBOT"]})
    probes.wait(0.0)
    seen["own probe that is accepted here"] = measure(meter, probes.opened)[:1]
with ExitStack() as stack:
    for _ in range(sockets.MOST_LOOK_UPS + 1):
        stack.enter_context(connected("ROBOT"))
    with open_meter() as meter:
        seen["many"] = measure(meter)[:1]
print(json.dumps(seen))
"""


@pytest.mark.skipif(
    os.geteuid() != 0 or not shutil.which("unshare"), reason="a network of its own needs root"
)
def test_all_connections_are_listed_only_where_one_may_be_new() -> None:
    """In a network of its own: on this machine others open connections all the time."""
    program = _SCENES.replace("ROBOT", ROBOT)
    words = [
        "unshare",
        "--net",
        "sh",
        "-c",
        'ip link set lo up && exec "$@"',
        "sh",
        sys.executable,
        "-c",
        program,
    ]
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, cwd=Path.cwd(), timeout=patience(60)
    )
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    # The kernel counts the handshake as one acknowledged byte.
    assert seen == {
        "nothing": [False, []],
        "known": [False, [70_000]],
        "known, again": [False, [5_000]],
        "new": [True, [9_001]],
        "no longer new": [False, [3_000]],
        "ended": [False],
        "own probes": [False, []],
        "own probes beside another": [True, [8_001]],
        "own probe that is accepted here": [True],
        "many": [True],
    }
